"""Test stances, strides and names of gaits on simulated motion with known footfalls and on real runs."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command_line import says

from recon import FitSettings, InputError, Pose3D, analyse, fit_clip, load_skeleton, read_pose3d
from recon.fit.regions import radius
from recon.gait.gait import (
    PERIOD_SIGMA,
    classify,
    gait,
    match_stances,
    name_gait,
    pose_gait,
    pose_period_s,
    rejection_text,
    strides,
)
from recon.gait.series import Errors
from recon.gait.stances import FEET, SLOW_SPEEDS, Stance, ground_plane, pose_tracks, stances
from recon.testing.gallop import KEYPOINT_NAMES, gallop

FPS = 90.0
NAMES = (*FEET.values(), "neck_base", "tail_base")
PATTERNS = {
    "walk": ({"LH": 0.0, "LF": 0.25, "RH": 0.5, "RF": 0.75}, 0.65),
    "trot": ({"LH": 0.0, "LF": 0.5, "RH": 0.5, "RF": 0.0}, 0.4),
    "pace": ({"LH": 0.0, "LF": 0.02, "RH": 0.5, "RF": 0.52}, 0.4),
    "bound": ({"LH": 0.0, "LF": 0.5, "RH": 0.0, "RF": 0.5}, 0.3),
    "half-bound": ({"LH": 0.0, "LF": 0.5, "RH": 0.0, "RF": 0.62}, 0.3),
    "rotary gallop": ({"LH": 0.0, "LF": 0.55, "RH": 0.1, "RF": 0.42}, 0.25),
    "transverse gallop": ({"LH": 0.0, "LF": 0.42, "RH": 0.1, "RF": 0.55}, 0.25),
}


def runner(
    phase: dict[str, float],
    duty: float,
    speed_m_s: float = 6.0,
    stride_s: float = 0.4,
    n: int = 150,
    heading: float = 0.7,
    slope: float = 0.05,
    height_m: float = -0.4,
) -> Pose3D:
    """Return the pose of an animal whose feet stand for `duty` of a stride and then swing forwards, on sloping ground.

    `phase` is the phase of each foot's touch-down, in strides. The speed of a swing is half a sine.
    """
    t = np.arange(n) / FPS
    step = speed_m_s * stride_s
    ahead = np.array([np.cos(heading), np.sin(heading), slope])
    left = np.array([-np.sin(heading), np.cos(heading), 0.0])
    points = []
    for foot in FEET:
        strides_in, into = np.divmod(t / stride_s - phase[foot], 1.0)
        s = np.clip((into - duty) / (1 - duty), 0, 1)
        x = step * (strides_in + phase[foot] + duty / 2 + 0.5 - 0.5 * np.cos(np.pi * s))
        x += 0.5 if foot.endswith("F") else -0.5
        side = 0.1 if foot.startswith("L") else -0.1
        lift = 0.15 * np.sin(np.pi * s) ** 2
        points.append(x[:, None] * ahead + side * left + (lift + height_m)[:, None] * [0, 0, 1])
    for x in (0.5, -0.5):
        points.append((speed_m_s * t + x)[:, None] * ahead + [0, 0, height_m + 0.65])
    return Pose3D(NAMES, np.stack(points, axis=1), np.arange(n))


def simulated(fps: float, n: int) -> Pose3D:
    clip = gallop(fps=fps, n_frames=n)
    return Pose3D(KEYPOINT_NAMES, clip.truth_m, np.arange(n))


@pytest.mark.parametrize("name", PATTERNS)
def test_gaits_have_their_names(name):
    phase, duty = PATTERNS[name]
    found = pose_gait(runner(phase, duty), FPS)
    assert found.name.name == name, found.name
    for foot in FEET:
        assert (found.name.phase[foot] - phase[foot] + 0.5) % 1 == pytest.approx(0.5, abs=0.02)
        # A foot counts as standing until it has a sixth of its largest speed in the swing, which is a half sine, so the
        # duty factor is a little larger than the fraction of a stride without motion.
        extra = 2 * (1 - duty) * np.arcsin(SLOW_SPEEDS[0]) / np.pi
        assert found.duty_factor[foot] == pytest.approx(duty + extra, abs=0.015)
    assert found.stride_frequency_hz == pytest.approx(2.5, rel=1e-3)
    assert found.stride_length_m == pytest.approx(2.4, rel=1e-3)
    assert found.speed_m_s == pytest.approx(6.0, rel=1e-3)
    assert found.name.criterion


def test_footfall_order():
    phase, duty = PATTERNS["rotary gallop"]
    found = pose_gait(runner(phase, duty), FPS)
    joined = "".join(f" {foot}" for foot in found.order)
    assert " LH RH RF LF LH RH RF LF" in joined
    touchdowns = np.array([s.start_s for s in found.stances if s.foot == "RF"])
    np.testing.assert_allclose(np.diff(touchdowns), 0.4, atol=2e-3)


def test_events_of_still_feet():
    """Stances begin and end within 20 ms of the times at which feet begin and cease to stand still."""
    phase, duty = PATTERNS["trot"]
    moved = pose_tracks(runner(phase, duty), FPS)
    whole = [s for s in stances(moved) if s.begins and s.ends and s.foot == "LF"]
    assert len(whole) >= 3
    for s in whole:
        k = round((s.start_s + s.end_s) / 2 / 0.4 - 0.5 - duty / 2)
        start, end = (k + 0.5) * 0.4, (k + 0.5 + duty) * 0.4
        assert start - 0.02 < s.start_s <= start + 0.011
        assert end - 0.011 <= s.end_s < end + 0.02


def test_the_height_of_the_ground_is_found():
    moved = pose_tracks(runner(*PATTERNS["trot"]), FPS)
    ahead = np.array([np.cos(0.7), np.sin(0.7)])
    ((_, ground),) = moved.grounds
    assert np.array(ground.slope) @ ahead == pytest.approx(0.05, abs=5e-3)
    assert moved.leg_m == pytest.approx(0.65, abs=0.03)
    rng = np.random.default_rng(0)
    xyz = np.column_stack([rng.uniform(0, 10, 300), rng.uniform(-1, 1, 300), np.zeros(300)])
    xyz[:, 2] = 1.0 + 0.04 * xyz[:, 0] + rng.normal(0, 0.01, 300)
    xyz[::10, 2] += 0.5
    plane = ground_plane(xyz[:, None], np.ones((300, 1), bool))
    assert plane.slope[0] == pytest.approx(0.04, abs=2e-3)
    np.testing.assert_allclose(plane.above(xyz)[1::10], 0.0, atol=0.05)
    assert plane.spread_m == pytest.approx(0.01, rel=0.4)


def test_every_segment_has_its_own_ground():
    """Every segment of a clip has its own ground, so stances do not change if the animal comes back 0.3 m lower."""
    whole = runner(*PATTERNS["trot"])
    n = len(whole.frames)
    first, second = slice(0, n // 2 - 10), slice(n // 2 + 10, n)
    xyz = np.full_like(whole.xyz_m, np.nan)
    xyz[first], xyz[second] = whole.xyz_m[first], whole.xyz_m[second]
    level = pose_tracks(replace(whole, xyz_m=xyz), FPS)
    xyz = xyz.copy()
    xyz[second, :, 2] -= 0.3
    moved = pose_tracks(replace(whole, xyz_m=xyz), FPS, segments=(first, second))
    assert [rows for rows, _ in moved.grounds] == [first, second]
    (_, above), (_, below) = moved.grounds
    on_it = np.array([[*below.middle_m, 0.0]])
    assert above.above(on_it) - below.above(on_it) == pytest.approx(-0.3, abs=0.03)
    assert moved.leg_m == pytest.approx(0.65, abs=0.03)
    assert np.nanmin(moved.height_m) > -0.03
    assert np.isnan(moved.height_m[10 * first.stop : 10 * second.start]).all()
    expected, found = stances(level), stances(moved)
    assert [(s.foot, s.begins, s.ends) for s in found] == [(s.foot, s.begins, s.ends) for s in expected]
    np.testing.assert_allclose([s.start_s for s in found], [s.start_s for s in expected], atol=0.02)


def test_default_feet_belong_to_the_cheetah():
    body = load_skeleton("cheetah-24")
    assert body.feet_by_label() == FEET


def test_stances_of_the_simulated_gallop():
    """Stances of the simulated gallop at 90 fps agree with the formula at 3600 fps to within one frame."""
    moved = pose_tracks(simulated(90.0, 90), 90.0)
    truth = simulated(3600.0, 3560)
    where = {name: i for i, name in enumerate(truth.names)}
    total = 0
    for foot, joint in FEET.items():
        paw = truth.xyz_m[:, where[joint], :2]
        speed = np.linalg.norm(np.gradient(paw, axis=0), axis=1) * 3600
        edges = np.flatnonzero(np.diff(np.r_[0, (speed < SLOW_SPEEDS[0] * np.percentile(speed, 95)).astype(int), 0]))
        slow = [(a, b - 1) for a, b in edges.reshape(-1, 2)]
        found = [s for s in stances(moved) if s.foot == foot]
        assert len(found) == len(slow)
        for (a, b), s in zip(slow, found, strict=True):
            total += 1
            assert s.start_row == pytest.approx(a / 40, abs=1.0)
            assert s.end_row == pytest.approx(b / 40, abs=1.0)
    assert total >= 12


def test_the_simulated_gallop_is_transverse():
    """The simulated gallop is transverse, since one side leads behind (by 0.08 of a stride) and in front (0.11)."""
    found = gait(pose_tracks(simulated(90.0, 90), 90.0))
    assert found.name.name == "transverse gallop"
    assert (found.name.phase["LH"] - found.name.phase["RH"]) % 1 == pytest.approx(0.08, abs=0.01)
    assert (found.name.phase["LF"] - found.name.phase["RF"]) % 1 == pytest.approx(0.12, abs=0.01)
    assert 3.2 < found.stride_frequency_hz < 3.4
    assert found.stride_length_m == pytest.approx(found.speed_m_s / found.stride_frequency_hz, rel=0.05)


def test_events_are_as_uncertain_as_the_paths_and_the_thresholds():
    pose = runner(*PATTERNS["rotary gallop"], n=100)
    exact = pose_gait(pose, FPS)
    sigma = np.full(pose.xyz_m.shape, 0.02)
    errors = (Errors(sigma, 0.05),)
    found = pose_gait(pose, FPS, errors)
    for a, b in zip(exact.stances, found.stances, strict=True):
        # With errors, a slowly moving foot may be standing, so stances are a little longer.
        assert a.start_s - 0.005 < b.start_s <= a.start_s
        assert a.end_s <= b.end_s < a.end_s + 0.005
        for known, before, after in (
            (a.begins, a.start_sigma_s, b.start_sigma_s),
            (a.ends, a.end_sigma_s, b.end_sigma_s),
        ):
            assert (0 < before < after) if known else (np.isnan(before) and np.isnan(after))
    # With such errors, the intervals contain the true events as often as stated.
    rng, time = np.random.default_rng(3), np.arange(len(pose.xyz_m)) / FPS
    together = np.linalg.cholesky(np.exp(-0.5 * ((time[:, None] - time) / 0.05) ** 2) + 1e-9 * np.eye(len(time)))
    inside = []
    for _ in range(5):
        noise = 0.02 * np.einsum("st,tjk->sjk", together, rng.normal(size=pose.xyz_m.shape))
        noisy = pose_gait(replace(pose, xyz_m=pose.xyz_m + noise), FPS, errors)
        for a, b in match_stances(exact.stances, noisy.stances):
            if a.begins and b.begins:
                inside.append(abs(b.start_s - a.start_s) < radius(0.9) * b.start_sigma_s)
            if a.ends and b.ends:
                inside.append(abs(b.end_s - a.end_s) < radius(0.9) * b.end_sigma_s)
    assert len(inside) > 60
    assert np.mean(inside) > 0.8
    low, high = found.name.duty_interval
    assert low < exact.name.duty_factor < high


def test_an_unknown_ground_gives_no_gait():
    pose = runner(*PATTERNS["trot"])
    feet = [NAMES.index(joint) for joint in FEET.values()]
    xyz = pose.xyz_m.copy()
    xyz[:, feet, 0] = xyz[:, feet[:1], 0].mean() + 5.0 * np.arange(len(xyz))[:, None] / FPS  # never slow
    found = pose_gait(replace(pose, xyz_m=xyz), FPS)
    assert (found.stances, found.name.name) == ((), "unknown")
    assert says(found.name.criterion, "is slow")
    xyz = pose.xyz_m.copy()
    xyz[:, feet, 2] += 0.5 * np.sin(np.arange(len(xyz)))[:, None]
    found = pose_gait(replace(pose, xyz_m=xyz), FPS)
    assert (found.stances, found.name.name) == ((), "unknown")
    assert "from a common plane" in found.name.criterion


def test_gaps_cut_stances_and_hide_strides():
    pose = runner(*PATTERNS["trot"])
    whole = pose_gait(pose, FPS)
    lf = NAMES.index("l_front_paw")
    stance = next(s for s in whole.stances if s.foot == "LF" and s.begins and s.ends)
    middle = round((stance.start_row + stance.end_row) / 2)
    xyz = pose.xyz_m.copy()
    xyz[middle : middle + 30, lf] = np.nan
    found = pose_gait(replace(pose, xyz_m=xyz), FPS)
    cut = next(s for s in found.stances if s.foot == "LF" and s.start_s == pytest.approx(stance.start_s, abs=0.005))
    assert (cut.begins, cut.ends) == (True, False)
    assert cut.end_row == middle - 1
    assert all(not (s.start_row < middle + 20 and s.end_row > middle) for s in found.stances if s.foot == "LF")
    assert len([s for s in found.strides if s.foot == "LF"]) < len([s for s in whole.strides if s.foot == "LF"])
    # Two missing frames are bridged.
    xyz = pose.xyz_m.copy()
    xyz[middle : middle + 2, lf] = np.nan
    assert len(pose_gait(replace(pose, xyz_m=xyz), FPS).stances) == len(whole.stances)


def test_only_complete_strides_count():
    pose = runner(*PATTERNS["rotary gallop"], n=40)  # 0.43 s, a stride is 0.4 s
    moved = pose_tracks(pose, FPS)
    for s in strides(moved, stances(moved)):
        assert s.end_s - s.start_s == pytest.approx(0.4, abs=0.01)
    short = pose_gait(runner(*PATTERNS["rotary gallop"], n=28), FPS)
    assert short.strides == ()
    assert short.name.name == "rotary gallop"
    assert says(short.name.criterion, "no complete stride")
    assert "a period of 0.4" in short.name.criterion
    assert np.isnan(short.stride_length_m)
    assert np.isnan(short.stride_frequency_hz)


@pytest.mark.parametrize("name", PATTERNS)
def test_gaits_in_less_than_a_stride_are_named_correctly_or_not_at_all(name):
    """Gaits are named correctly or not at all in clips of 0.33 and 0.42 s, with strides of 0.4 s."""
    whole, names = runner(*PATTERNS[name]), set()
    for first in range(30, 66, 4):
        for n in (30, 38):
            found = pose_gait(Pose3D(NAMES, whole.xyz_m[first : first + n], np.arange(n)), FPS)
            if not found.strides:
                names.add(found.name.name)
                assert "no " in found.name.criterion
                assert np.isnan(found.stride_length_m)
    if name in ("walk", "trot", "pace"):
        assert names == {"unknown"}
    else:
        assert names in ({name}, {name, "unknown"})


def test_a_stride_across_standing_still_does_not_count():
    """A stride does not count if the animal stops on all feet for a second in it."""
    pose, at = runner(PATTERNS["trot"][0], 0.65), 56
    assert np.ptp(pose.xyz_m[at - 1 : at + 2, :4], axis=0).max() < 1e-9
    stops = np.concatenate([pose.xyz_m[:at], np.repeat(pose.xyz_m[at : at + 1], 90, axis=0), pose.xyz_m[at:]])
    went, stopped = (gait(pose_tracks(Pose3D(NAMES, m, np.arange(len(m))), FPS)) for m in (pose.xyz_m, stops))
    assert len(stopped.strides) == len(went.strides) - 4
    assert stopped.stride_s == pytest.approx(went.stride_s, rel=0.01)
    assert stopped.rejected_strides == ()


def test_an_animal_that_stands_has_no_gait():
    pose = runner(*PATTERNS["trot"], n=20)
    still = replace(pose, xyz_m=np.tile(pose.xyz_m[:1], (20, 1, 1)))
    found = pose_gait(still, FPS)
    assert found.stances == ()
    assert found.name.name == "unknown"


@pytest.mark.parametrize(
    ("phase", "duty", "why"),
    [
        ({"LH": 0.0, "RH": 0.5, "LF": 0.5, "RF": 0.0}, np.nan, "undecided"),
        ({"LH": 0.0, "RH": 0.5, "LF": 0.25, "RF": 0.75}, 0.4, "between trot and pace"),
        ({"LH": 0.0, "RH": 0.5, "LF": 0.5, "RF": 0.7}, 0.4, "one pair alternates"),
        ({"LH": 0.0, "RH": 0.2, "LF": 0.5, "RF": 0.5}, 0.4, "fore pair lands together"),
        ({"LH": 0.0, "RH": 0.2, "LF": np.nan, "RF": 0.5}, 0.4, "no steady phase of LF"),
        ({"LH": 0.0, "RH": 0.63, "LF": 0.14, "RF": 0.83}, 0.73, "in stance for 73 % of the stride, longer"),
    ],
)
def test_phases_without_a_name(phase, duty, why):
    name, criterion = classify(phase, duty)
    assert name == "unknown"
    assert why in criterion


def test_the_foot_that_lands_second_leads():
    name, criterion = classify({"LH": 0.0, "RH": 0.9, "LF": 0.3, "RF": 0.45}, 0.2)
    assert name == "rotary gallop"
    said = "hind feet 0.10 of a stride apart, right first; fore feet 0.15, left first; leading: left hind, right fore"
    assert criterion == said


@pytest.mark.parametrize(("duty", "name"), [(0.45, "transverse gallop"), (0.7, "unknown")])
def test_feet_that_stand_longer_than_half_a_stride_do_not_gallop(duty, name):
    """Without a complete stride, the uncertain phases of a walking horse can look like the phases of a gallop."""
    phases = PATTERNS["transverse gallop"][0]
    all_stances = [Stance(foot, p, p + duty, 30 * p, 30 * (p + duty), ends=p < 0.5) for foot, p in phases.items()]
    all_stances.append(Stance("LH", 0.95, 1.0, 28.5, 30.0, ends=False))  # cut by the end of the clip
    found = name_gait(tuple(all_stances), (), 1.0)
    assert found.name == name
    assert ("more than half" in found.criterion) == (name == "unknown")


def test_names_do_not_depend_on_where_phases_start():
    for name, (phase, duty) in PATTERNS.items():
        for shift in (0.3, 0.77):
            assert classify({foot: (p + shift) % 1 for foot, p in phase.items()}, duty)[0] == name


def test_matching_is_one_to_one():
    def stance(foot: str, start: float, end: float, begins: bool = True) -> Stance:
        return Stance(foot, start, end, 10 * start, 10 * end, begins)

    first = (stance("LF", 0.0, 1.0), stance("LF", 2.0, 3.0), stance("RF", 0.0, 1.0, begins=False), stance("LH", 0, 1))
    second = (stance("LF", 0.1, 0.4), stance("LF", 0.5, 1.2), stance("LF", 2.1, 2.8), stance("RF", 0.3, 0.9))
    pairs = match_stances(first, second)
    assert pairs == [(first[0], second[1]), (first[1], second[2]), (first[2], second[3])]
    assert match_stances((), ()) == []


@pytest.mark.parametrize("share", [0.75, 0.9, 1.0])
@pytest.mark.parametrize("name", ["trot", "rotary gallop"])
def test_the_period_is_found_in_less_than_a_stride(name, share):
    pose = runner(*PATTERNS[name], n=round(share * 0.4 * FPS))
    noisy = replace(pose, xyz_m=pose.xyz_m + 0.01 * np.random.default_rng(0).normal(size=pose.xyz_m.shape))
    assert pose_period_s(pose_tracks(noisy, FPS)) == pytest.approx(0.4, rel=1.6 * PERIOD_SIGMA)
    noise = replace(pose, xyz_m=np.random.default_rng(0).normal(size=pose.xyz_m.shape))
    assert np.isnan(pose_period_s(pose_tracks(noise, FPS)))


def test_half_a_stance_is_not_a_stride():
    """Half a stance is not a stride in a clip without other strides.

    A foot that seems to slide for a moment would have a stride of a fraction of the motion's period.
    """
    phase, duty = PATTERNS["trot"]
    pose, t = runner(phase, duty), np.arange(150) / FPS
    xyz, foot = pose.xyz_m.copy(), NAMES.index(FEET["RF"])
    xyz[np.argmin(np.abs(t - 0.48)), foot, 0] += 0.15
    short = (t > 0.35) & (t < 0.72)
    found = pose_gait(replace(pose, xyz_m=xyz[short], frames=pose.frames[short]), FPS)
    assert not found.strides
    assert [stride.foot for stride in found.rejected_strides] == ["RF"]
    assert found.rejected_strides[0].duration_s < 0.2
    assert found.stride_s == pytest.approx(0.4, rel=1.6 * PERIOD_SIGMA)


def test_strides_with_a_missing_or_additional_stance_do_not_count():
    """Strides with a stance too few or too many do not count.

    A foot that is seen in the air during a stance would have a stride of twice the time, and a foot that seems to slide
    during a stance would have two short ones. This also holds if the other feet are not seen yet.
    """
    phase, duty = PATTERNS["trot"]
    pose, t = runner(phase, duty), np.arange(150) / FPS
    xyz, foot = pose.xyz_m.copy(), NAMES.index(FEET["RF"])
    xyz[(t > 0.75) & (t < 1.0), foot, 2] += 0.4
    xyz[np.argmin(np.abs(t - 0.48)), foot, 0] += 0.15
    clean = pose_gait(pose, FPS)
    assert not clean.rejected_strides
    found = pose_gait(replace(pose, xyz_m=xyz), FPS)
    assert {stride.foot for stride in found.rejected_strides} == {"RF"}
    took = sorted(stride.end_s - stride.start_s for stride in found.rejected_strides)
    assert took[0] < 0.2
    assert took[-1] > 0.6
    assert found.stride_frequency_hz == pytest.approx(2.5, rel=0.01)
    assert len(found.strides) >= 8
    text = rejection_text(found.rejected_strides[0])
    assert text.startswith("RF's stride from ")
    assert says(text, "does not count")
    assert "repeats after 0.4" in text
    others = [NAMES.index(FEET[other]) for other in ("LH", "RH", "LF")]
    xyz[(t[:, None] < 0.7) & np.isin(np.arange(len(NAMES)), others)] = np.nan
    later = pose_gait(replace(pose, xyz_m=xyz), FPS)
    assert later.rejected_strides[0].duration_s < 0.2
    assert later.stride_s == pytest.approx(0.4, rel=0.01)


def test_bad_input():
    pose = runner(*PATTERNS["trot"], n=20)
    lacking = Pose3D(pose.names[2:-1], pose.xyz_m[:, 2:-1], pose.frames)
    with pytest.raises(InputError) as error:
        pose_gait(lacking, FPS)
    assert len(error.value.problems) == 3
    with pytest.raises(ValueError, match="positive frame rate"):
        pose_gait(pose, -1.0)
    with pytest.raises(ValueError, match="at least 4 frames"):
        pose_gait(Pose3D(pose.names, pose.xyz_m[:3], pose.frames[:3]), FPS)
    empty = replace(pose, xyz_m=np.full(pose.xyz_m.shape, np.nan))
    assert pose_gait(empty, FPS).stances == ()


def test_stances_agree_with_the_force_plates(shared_data: Path):
    """All stances on the force plates are found, with touch-downs within two frames and lift-offs within four.

    The reconstructions come from several cameras at 200 Hz.
    """
    folders = sorted(p.parent for p in (shared_data / "plate-trials").glob("*/stances.csv"))
    if not folders:
        pytest.skip("no plate trials")
    for folder in folders:
        pose = read_pose3d(folder / "truth.csv")
        found, measured = stances(pose_tracks(pose, 200.0)), pd.read_csv(folder / "stances.csv").set_index("joint")
        assert sorted(s.foot for s in found) == sorted(FEET)
        off = np.array([(s.start_row, s.end_row) - measured.loc[FEET[s.foot]].to_numpy() for s in found])
        touch_down, lift_off = np.median(off + pose.frames[0], axis=0)
        assert abs(touch_down) <= 2
        assert abs(lift_off) <= 4


def test_a_walking_dog_walks(shared_data: Path):
    """A foot of a walking dog stands for 55 to 65 % of the time, at any speed of the body."""
    folder = shared_data / "dog-mocap"
    if not folder.is_dir():
        pytest.skip("no dog")
    body = load_skeleton("dog-27")
    capture = json.loads((folder / "joints.json").read_text())
    joints = capture["joints"]
    for name in ("walk00", "walk01", "walk02"):
        columns = range(3 * len(joints))
        rows = np.loadtxt(folder / f"dog_{name}_joint_pos.txt", delimiter=",", usecols=columns)
        points_m = rows.reshape(-1, len(joints), 3)[:, [joints.index(m) for m in body.markers]][..., [2, 0, 1]]  # y up
        pose = Pose3D(body.markers, points_m, np.arange(len(points_m)))
        found = gait(pose_tracks(pose, capture["fps"], feet=body.feet_by_label(), body=body.forward))
        assert found.name.name == "walk", found.name.criterion
        assert 0.54 < found.name.duty_factor < 0.66


@pytest.mark.slow
def test_a_led_horse_walks(shared_data: Path):
    """A led horse walks, although its labels were set by hand and the skeleton fits it only roughly."""
    labels = shared_data / "horse-side" / "CollectedData_Byron.csv"
    given = FitSettings(keypoints=(labels,), skeleton="horse-22", fps=24.0, hfov_deg=50.0, image_size_px=(288, 162))
    motion = fit_clip(given)
    assert motion.verdict is not None
    assert motion.verdict.level == "check"
    gait = analyse(motion).gait
    assert gait.name.name == "walk"
    assert 0.6 < gait.name.duty_factor < 0.8
