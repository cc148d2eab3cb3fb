"""Networks.

* ``regression``: bodies from part labels and keypoints, or from a picture.
* ``detection``: people in pictures, their keypoints and masks, by the packaged networks.
* ``predictors``: part and keypoint networks of others.
"""
