"""From one person's keypoints and labels to a body: stages, starts, and what looks wrong at the end."""
