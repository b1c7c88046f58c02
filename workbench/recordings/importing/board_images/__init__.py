"""Import of images of a board with flange poses: which image belongs to which row, units, and a review of the poses."""
