"""Views of a clip -> an animal's motion over the whole clip.

This room is the only place that solves for an animal's motion, besides the frame method of `recon.thesis`.
`recon.fit.constants` has the numbers that no user sets.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
