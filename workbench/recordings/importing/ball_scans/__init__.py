"""Import of scans of one ball (clouds or profiles) with flange poses, and a review of their poses."""
