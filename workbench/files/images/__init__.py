"""Common parts of image jobs: folders of images, flange poses, ball names, visibility and ground truth."""
