"""Define numbers that several checks share and that no user sets, each with its reason."""

LIMIT_OF_TRUNK = 0.2
"""Mean error of the joints, relative to the trunk's length, that spoils most uses: 14 cm for a cheetah.

A clip may be used if its error is below this limit with a probability of 95 %, and must not be used if a larger error
is more likely than not. A finding with a smaller effect on poses and positions is not an error.
"""
EFFECT_OF_NOTE = 0.25
"""Fraction of `LIMIT_OF_TRUNK` up to which an effect is only a note.

The effect is then 3.5 cm for a cheetah, about the error of the fit itself.
"""
MANY_FRAMES = 1 / 3
"""Fraction of the frames, or of the detections, above which faulty ones are reported.

The rest would no longer represent the clip.
"""
