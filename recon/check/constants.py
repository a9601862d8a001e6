"""Define the constants that several checks share, each with its reason."""

LIMIT_OF_TRUNK = 0.2
"""Mean error of the joints, relative to the trunk's length, above which a result is of no use for most purposes.

The limit is 14 cm for a cheetah. The verdict on a clip is "use" if its error is below this limit with a probability of
95 %, and "do not use" if its error is more likely above than below it. A finding with a smaller effect on poses and
positions is not an error.
"""
EFFECT_OF_NOTE = 0.25
"""Largest effect of a finding that is only a note, as a fraction of `LIMIT_OF_TRUNK`.

The effect is then at most 3.5 cm for a cheetah, about the error of the fit itself.
"""
MANY_FRAMES = 1 / 3
"""Fraction of faulty frames or detections above which they are reported.

With more of them, the other frames or detections would no longer represent the clip.
"""
