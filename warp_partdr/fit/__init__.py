"""Fit of a body to one person's keypoints and labels: stages, starts, result and warnings."""
