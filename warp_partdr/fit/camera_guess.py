"""A camera for a picture of which none is known, where the label network sees that it was near."""

from __future__ import annotations

from ..cameras import Crop, Perspective
from ..network.predicted import Predicted

# [1/m]: the network says the median of what may be, which of photos is too far: who seems to be beyond 10 m is taken to
# be there.
_LEAST = 0.1


def guess_camera(predicted: Predicted, crop: Crop, image_size: tuple[int, int], within: float) -> Perspective | None:
    """The camera that a person stands before as near as the network says, its axis in the picture's middle.

    Args:
        predicted: One person, B = 1, by a label network that was told of no camera.
        crop: Where the person was cut out of the picture.
        image_size: (H, W) of the picture [px].
        within: Distance [m] within which it is believed.

    Returns:
        None if the person is farther.
    """
    said = predicted.uncertainty
    assert said is not None  # of label networks
    nearness = float(said.nearness[0])
    if nearness * within < 1:
        return None
    nearness = max(nearness, _LEAST)
    pixels = float(predicted.log_scale[0].exp()) * crop.size[0] / 2 / crop.zoom  # [px/m] at the person
    return Perspective.of_picture(image_size, focal=pixels / nearness)
