"""Animals: their bodies as trees of segments, files of skeletons, subjects and detectors, names, and motion priors."""

from typing import TYPE_CHECKING

from recon.base import lazily

if TYPE_CHECKING:
    from recon.animal.body import MIN_JOINTS, Body, Side, opposites, other_side, side_of
    from recon.animal.chain import Chain, builtin_chains, facing_side, load_chain, upright_rotation
    from recon.animal.measured import detector_toml, save_prior, subject_toml
    from recon.animal.naming import (
        NameMap,
        both_sides,
        builtin_maps,
        fitting_maps,
        fitting_skeleton,
        load_names,
        map_to_write,
        new_names,
        problem_of_names,
        renamed,
        skeleton_of,
        suggestions,
        without_side,
    )
    from recon.animal.prior import ANGLES, MotionPrior, builtin_priors, load_prior, mean_speed_m_s, prior_from_body
    from recon.animal.prior_fit import fit_prior
    from recon.animal.skeleton_file import builtin_names, builtin_subjects, load_skeleton, with_detector_offsets

__getattr__ = lazily(__name__, __file__)
