"""Part and keypoint networks of others, for people whom ``detection`` found in a photo.

A network is a ``PartNetwork`` or a ``KeypointNetwork``: a function of pictures, and what its results mean. Checkpoints
of ``transformers`` become such (``load_part_network``, ``load_keypoint_network``; the extra "photo"), and so does a
user's own function. A network sees each person in a crop of its own, turned upright as the detector saw the person.
"""
