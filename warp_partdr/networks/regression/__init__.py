"""Networks that predict a body as a fit's start: from part labels and keypoints, or from a picture."""
