"""What a class of motions looks like: which poses occur, how likely they are, and how they change.

A prior is about a body's angles z = state[4:], the root's pitch and roll and the joints' angles: not about where the
animal is, where it heads or how large it is. Built-in priors are the files of `recon/animal/priors`, statistics only.
"""

from typing import TYPE_CHECKING

from recon.base.front_door import lazily

if TYPE_CHECKING:
    from recon.animal.prior.file import builtin_priors, load_prior, save_prior
    from recon.animal.prior.fit import FRAMES_PER_COMPONENT, fit_prior
    from recon.animal.prior.model import (
        ANGLES,
        NONE,
        MotionPrior,
        as_one_gaussian,
        log_likelihood,
        mean_speed_m_s,
        prior_from_body,
    )

__getattr__ = lazily(__name__, __file__)
