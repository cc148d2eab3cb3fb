"""Input of a fit: keypoints and part labels from files, and the observation of one person made of them."""
