"""What image jobs share: folders of images, flange poses, ball names, visibility and ground truth."""
