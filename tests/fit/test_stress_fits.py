"""Test that some clips of `tests/fuzz/stress_fits.py` end in a sound result, or are refused, by both methods."""

from __future__ import annotations

import pytest
from fuzz import stress_fits
from fuzz.stress_fits import Case

from recon.animal.skeleton_file import builtin_names

CHAIN, WHOLE = ("frame", "cheetah-8u"), ("trajectory", "horse-22")
RESULTS = [
    (CHAIN, "fisheye", stress_fits.frame_outside, 24),
    (CHAIN, "pinhole", stress_fits.all_equal, 2),
    (CHAIN, "radtan", stress_fits.constant, 3),
    (CHAIN, "world", stress_fits.noise, 2),
    (CHAIN, "fisheye", stress_fits.first_frame_only, 3),
    (WHOLE, "fisheye", stress_fits.frame_outside, 24),
    (WHOLE, "world", stress_fits.frame_huge, 12),
    (WHOLE, "pinhole", stress_fits.all_equal, 3),
    (WHOLE, "radtan", stress_fits.tiny, 2),
    (WHOLE, "world", stress_fits.missing_frames, 2),
    (WHOLE, "pinhole", stress_fits.few_keypoints, 3),
]


@pytest.mark.parametrize(
    ("fit", "camera", "spoilt", "frames"), RESULTS, ids=[f"{fit[0]}-{spoilt.__name__}" for fit, _, spoilt, _ in RESULTS]
)
def test_damaged_clip_gives_a_result(fit, camera, spoilt, frames):
    options = (("fast", True),) if fit is WHOLE else ()
    ended = stress_fits.run(Case(*fit, camera, spoilt, frames, 60.0, options, 3))
    assert (ended.how, ended.why) == ("result", ())


@pytest.mark.parametrize(
    ("spoilt", "fps", "why"),
    [
        (stress_fits.nothing, 0.5, "fps: found 0.5, expected 1 to 10000 frames per second"),
        (stress_fits.nothing, 1e300, "fps: found 1e+300, expected 1 to 10000 frames per second"),
        (stress_fits.all_huge, 60.0, "image size: found 1920x1080, but keypoints at"),
        (stress_fits.nothing_at_all, 60.0, "found every point of the clip missing"),
    ],
)
@pytest.mark.parametrize("fit", [CHAIN, WHOLE])
def test_unusable_clip_is_refused(fit, spoilt, fps, why):
    ended = stress_fits.run(Case(*fit, "pinhole", spoilt, 3, fps, (), 5))
    assert ended.how == "refused"
    assert len(ended.why) == 1
    assert why in ended.why[0]


def test_every_kind_of_damage_is_tested():
    chosen = stress_fits.cases(400, 0)
    assert {case.spoilt for case in chosen} == set(stress_fits.SPOILT)
    assert {case.skeleton for case in chosen} == {*builtin_names()}
    assert {case.method for case in chosen} == {"frame", "trajectory"}
    assert stress_fits.cases(400, 0) == chosen
