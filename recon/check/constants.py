"""Numbers of the checks that no user sets and that several of them share, each with its reason."""

LIMIT_OF_TRUNK = 0.2
"""Mean error of the joints, relative to the trunk's length, that spoils most uses: 14 cm for a cheetah.

A clip is to be used if its error is below that with 95 %, and not to be used if it is above more likely than not. A
finding whose effect on poses and positions is below it is no error.
"""
EFFECT_OF_NOTE = 0.25
"""Part of that limit up to which an effect is only noted: 3.5 cm for a cheetah, about what the fit itself is off."""
MANY_FRAMES = 1 / 3
"""Share of the frames, or of the detections, from which a clip without them is another clip than was filmed."""
