"""Networks that say at once where a fit should start: from part labels and keypoints, or from a picture."""
