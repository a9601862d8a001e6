"""Test the centre of mass, energies and forces against values computed independently of the tested code."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command_line import says

from recon import ClipAnalysis, InputError, Motion, analyse, load_skeleton
from recon.animal.capsules import capsules, inertias_m2, middles_m
from recon.api.analyse import summarise
from recon.gait.dynamics import (
    FORCE_SKEW,
    G_M_S2,
    MEAN_OF_PEAK,
    OFF_GRAVITY,
    OVER_STRIDE,
    StanceForce,
    _forces,
    _turning_sigma,
    findings_of_dynamics,
    off_gravity,
    over_stride,
    shape,
    validity_text,
)
from recon.gait.series import Errors
from recon.gait.stances import Stance
from recon.show import plots
from recon.show.page.pages import clip_page
from recon.show.tables import forces, strides
from recon.testing.steady_gait import GALLOP, TROT, SteadyGait, compare_forces, with_exact_states

SKELETON = Path(__file__).parents[2] / "recon" / "animal" / "skeletons" / "cheetah-24.toml"


@pytest.fixture(scope="module")
def motion(whole_results: Path) -> Motion:
    return Motion.load(whole_results)


@pytest.fixture(scope="module")
def found(motion: Motion) -> ClipAnalysis:
    return analyse(motion)


def test_masses_are_shares_of_every_segment():
    body = load_skeleton("cheetah-24")
    assert body.mass.keys() == {segment.name for segment in body.tree.segments}
    assert sum(share for share, _ in body.mass.values()) == pytest.approx(1.0, abs=0.03)
    assert body.mass["r_hind_thigh"] == body.mass["l_hind_thigh"]
    assert body.mass_source is not None
    assert load_skeleton("cheetah-8u").mass == {}


def test_problems_of_masses_are_listed(tmp_path: Path):
    text = SKELETON.read_text(encoding="utf-8")
    (tmp_path / "s.toml").write_text(text.replace("head = [0.10, 0.03]", "hat = [0.10, 0.03]"), encoding="utf-8")
    with pytest.raises(InputError) as error:
        load_skeleton(tmp_path / "s.toml")
    said = {problem.field: (problem.found, problem.expected) for problem in error.value.problems}
    assert said["mass.share.hat"][0] == "'hat'"
    assert says(said["mass.share.hat"][1], "front_trunk, head")
    assert said["mass.share.head"][0] == "nothing"


def test_the_centre_of_mass_moves_as_the_body_and_is_within_it(motion: Motion, found: ClipAnalysis):
    d = found.dynamics
    assert d is not None
    centre = d.centre.series.value[:: d.centre.series.oversampling]
    trunk = [motion.upright.names.index(name) for name in motion.forward_names]
    middle = motion.upright.xyz_m[:, trunk].mean(axis=1)
    assert np.abs(centre - middle).max() < 0.35
    # With all mass on one segment, the centre of mass is the middle of that segment, here between knee and ankle.
    shares = {name: (1.0 if name == "l_fore_lower" else 1e-12, 1e-12) for name in motion.body.mass}
    body = replace(motion.body, mass=shares)
    one = analyse(replace(motion, solution=replace(motion.solution, body=body))).dynamics
    assert one is not None
    knee, ankle = (motion.upright.xyz_m[:, motion.upright.names.index(f"l_front_{n}")] for n in ("knee", "ankle"))
    at_frames = one.centre.series.value[:: one.centre.series.oversampling]
    np.testing.assert_allclose(at_frames, (knee + ankle) / 2, atol=0.03)


def test_energies_follow_from_the_path(found: ClipAnalysis):
    d = found.dynamics
    assert d is not None
    series, energy = d.centre.series, d.energy_j_kg
    kinetic = sum(energy[f"kinetic_{way}"] for way in ("forwards", "sideways", "up"))
    np.testing.assert_allclose(kinetic, 0.5 * d.centre.speed_m_s**2, rtol=1e-9)
    np.testing.assert_allclose(energy["potential"], G_M_S2 * (series.value[:, 2] - d.ground_m), rtol=1e-9)
    np.testing.assert_allclose(energy["total"], kinetic + energy["potential"] + energy["internal"], rtol=1e-9)
    assert (energy["internal"] > 0).all()
    sigma = d.energy_sigma_j_kg
    np.testing.assert_allclose(sigma["potential"], G_M_S2 * series.value_sigma[:, 2])
    np.testing.assert_allclose(sigma["kinetic_up"], np.abs(series.rate[:, 2]) * series.rate_sigma[:, 2])
    assert (sigma["total"] > np.hypot(sigma["potential"], sigma["kinetic_up"])).all()


def test_forces_of_a_stride_carry_the_body(found: ClipAnalysis):
    d, gait = found.dynamics, found.gait
    assert d is not None
    assert gait is not None
    by_foot = d.forces.groupby("foot")["impulse_bw_s"].mean()
    assert by_foot.sum() == pytest.approx(gait.stride_s, rel=1e-3)  # each stance uses the strides at its time
    assert len(d.forces)
    for force in d.forces.to_dict("records"):
        time_s = gait.tracks.time_s
        inside = (time_s > force["start_s"]) & (time_s < force["end_s"])
        near = (time_s > force["start_s"] - 0.06) & (time_s < force["end_s"] + 0.06)
        middle, low, high = d.force[force["foot"]].T
        assert np.trapezoid(np.where(near, middle, 0.0), time_s) == pytest.approx(force["impulse_bw_s"], rel=0.05)
        assert 0.7 * force["peak_bw"] < middle[inside].max() < force["peak_bw"]
        assert force["peak_low_bw"] < force["peak_bw"] < force["peak_high_bw"]
        assert force["impulse_low_bw_s"] < force["impulse_bw_s"] < force["impulse_high_bw_s"]
        assert (low[inside] <= high[inside]).all()
    # A stance that the clip's end cuts to an instant has no force, and causes no division by zero.
    cut = replace(gait.stances[0], end_s=gait.stances[0].start_s, ends=False, end_sigma_s=np.nan)
    of_others = _forces(replace(gait, stances=(cut, *gait.stances[1:])))[0]
    assert len(of_others) == len(d.forces) - (gait.stances[0].begins and gait.stances[0].ends)


@pytest.mark.parametrize(("run", "fps", "name"), [(GALLOP, 120.0, "transverse gallop"), (TROT, 60.0, "trot")])
def test_forces_on_an_animal_are_found_from_exact_poses(motion: Motion, run: SteadyGait, fps: float, name: str):
    found = analyse(with_exact_states(motion, run.states(motion.body, motion.frames / fps), fps))
    assert found.gait is not None
    assert found.gait.name.name == name
    off = compare_forces(run, found)
    assert off.centre_m < 1e-12
    assert off.kinetic_j_kg < 0.002
    assert off.rms_bw < 0.15
    assert off.inside > 0.9


def test_a_rigid_animal_that_turns_has_the_energy_and_the_momentum_of_its_inertia(motion: Motion):
    body, rate_rad_s = motion.body, 3.0
    tree, shape = body.tree, capsules(body.tree, body.markers)
    states = np.tile(np.concatenate([np.zeros(4), body.mean_rad]), (len(motion.frames), 1))
    states[:, 3] = rate_rad_s * motion.time_s
    share = np.array([body.mass[segment.name][0] for segment in tree.segments])
    share /= share.sum()
    turned = tree.orientations(states[:1])[0]
    at = tree.origins(states[:1])[0] + np.einsum("sij,sj->si", turned, middles_m(tree, shape))
    own = np.einsum("si,sij,sj->s", turned[:, 2], inertias_m2(tree, shape), turned[:, 2])
    apart = np.sum((at - share @ at)[:, :2] ** 2, axis=1)
    inertia = share @ (apart + own)
    d = analyse(with_exact_states(motion, states, motion.fps)).dynamics
    assert d is not None
    middle = slice(100, -100)
    # Rods have no thickness, so they lack a part of the capsules' inertia, which is little for the whole animal.
    np.testing.assert_allclose(d.internal_j_kg[middle], 0.5 * inertia * rate_rad_s**2, rtol=0.03)
    np.testing.assert_allclose(d.angular_momentum[middle, 2], inertia * rate_rad_s, rtol=0.03)
    assert share @ own > 0.08 * inertia


def test_the_uncertainty_of_rotation_agrees_with_random_draws():
    rng, share, error_time_s = np.random.default_rng(0), np.array([0.2, 0.2, 0.3, 0.3]), 0.05
    of_joint, share_sigma = np.array([0, 1, 1, 2]), np.array([0.04, 0.06])
    at_m, rate_m_s, sigma_m = (
        rng.normal(size=(1, 4, 3)),
        3 * rng.normal(size=(1, 4, 3)),
        rng.uniform(0, 0.02, (1, 3, 3)),
    )
    # The rods' ends are given relative to the centre of mass.
    at_m, rate_m_s = (of - np.einsum("tek,e->tk", of, share)[:, None] for of in (at_m, rate_m_s))
    near = Errors(sigma_m[:, of_joint], error_time_s)
    said = _turning_sigma(at_m, rate_m_s, share, share_sigma, of_joint, near)[0]

    place, rate = (rng.normal(size=(20000, 3, 3)) * sigma_m * of for of in (1, 1 / error_time_s))
    drawn = np.repeat(share[::2] + share_sigma / 2 * rng.normal(size=(20000, 2)), 2, axis=1)
    drawn /= drawn.sum(axis=1, keepdims=True)
    at_m, rate_m_s = at_m + place[:, of_joint], rate_m_s + rate[:, of_joint]
    at_m, rate_m_s = (of - np.einsum("tek,te->tk", of, drawn)[:, None] for of in (at_m, rate_m_s))
    energy = 0.5 * np.einsum("tek,tek,te->t", rate_m_s, rate_m_s, drawn)
    momentum = np.einsum("tek,te->tk", np.cross(at_m, rate_m_s), drawn)
    np.testing.assert_allclose(said, np.std(np.column_stack([energy, momentum]), axis=0), rtol=0.05)


def test_an_uncertain_stance_lasts_about_as_long_as_the_others(found: ClipAnalysis):
    gait = found.gait
    assert gait is not None
    i = next(i for i, stance in enumerate(gait.stances) if stance.begins and stance.ends)
    known, quarter_s = gait.stances[i], gait.stances[i].duration_s / 4

    def first_force(stance: Stance) -> StanceForce:
        """Return the force of the first stance if it is replaced by another stance."""
        stance_forces, _ = _forces(replace(gait, stances=(*gait.stances[:i], stance, *gait.stances[i + 1 :])))
        return stance_forces[0]

    short = replace(known, end_s=known.start_s + 2 * quarter_s, start_sigma_s=quarter_s, end_sigma_s=quarter_s)
    before, after = map(first_force, (known, short))
    assert after.foot == known.foot
    assert after.peak_bw < 1.5 * before.peak_bw  # twice as high if the short duration were used
    assert after.peak_high_bw < 1.6 * before.peak_high_bw
    # A part of a stance also gets the usual duration. A stance with known ends keeps its own.
    part = replace(known, end_s=known.start_s + quarter_s / 2, start_sigma_s=quarter_s / 6, end_sigma_s=quarter_s / 6)
    longer = first_force(part)
    assert longer.start_s == part.start_s
    assert longer.peak_bw < 3 * before.peak_bw  # eight times as high if the short duration were used
    sure = replace(known, start_sigma_s=1e-4, end_sigma_s=1e-4)
    taken = first_force(sure)
    assert taken.start_s == sure.start_s
    assert taken.impulse_bw_s == pytest.approx(taken.peak_bw * MEAN_OF_PEAK * sure.duration_s, rel=0.01)


def test_a_detection_much_shorter_than_a_stance_has_no_force(found: ClipAnalysis):
    """The detection would have the impulse of a whole stance, and several times the force of the other stances."""
    gait = found.gait
    assert gait is not None
    i = next(i for i, stance in enumerate(gait.stances) if stance.begins and stance.ends)
    known = gait.stances[i]
    wrong = replace(known, end_s=known.start_s + known.duration_s / 10, start_sigma_s=1e-4, end_sigma_s=1e-4)
    rows, over_time = _forces(replace(gait, stances=(*gait.stances[:i], wrong, *gait.stances[i + 1 :])))
    usual_rows, usual_over_time = _forces(gait)
    assert len(rows) == len(usual_rows) - 1
    assert all(row.start_s != wrong.start_s for row in rows)
    assert max(row.peak_bw for row in rows) < 1.2 * max(row.peak_bw for row in usual_rows)
    inside = (gait.tracks.time_s > wrong.start_s) & (gait.tracks.time_s < wrong.end_s)
    assert np.isnan(over_time[known.foot][inside]).all()
    assert np.isfinite(usual_over_time[known.foot][inside]).all()


def test_an_unknown_gait_is_not_taken_for_a_gallop(found: ClipAnalysis):
    gait = found.gait
    assert gait is not None
    rows = {
        name: _forces(replace(gait, name=replace(gait.name, name=name)))[0]
        for name in ("rotary gallop", "walk", "unknown")
    }
    assert rows["unknown"] == rows["walk"] != rows["rotary gallop"]
    assert "unknown gait" in validity_text("unknown")
    assert "a walk" in validity_text("walk")
    assert "assumed" not in validity_text("rotary gallop")


def test_the_force_begins_and_ends_at_zero_and_peaks_early():
    into = np.linspace(-0.2, 1.2, 1401)
    force = shape(into)
    assert (force[(into <= 0) | (into >= 1)] == 0).all()
    assert into[force.argmax()] == pytest.approx(0.5 ** (1 / FORCE_SKEW), abs=1e-3)
    assert np.trapezoid(force, into) == pytest.approx(MEAN_OF_PEAK, rel=1e-4)
    assert np.trapezoid(into * force, into) / MEAN_OF_PEAK == pytest.approx(0.44, abs=0.03)


def test_without_masses_there_are_no_dynamics(motion: Motion):
    from recon.api.analyse import notes

    plain = replace(motion, solution=replace(motion.solution, body=replace(motion.body, mass={}, mass_source=None)))
    found = analyse(plain)
    assert found.dynamics is None
    assert any("has no masses ([mass])" in note for note in notes(found))


def test_without_forces_the_notes_say_why(motion: Motion, found: ClipAnalysis):
    from recon.api.analyse import notes

    fps = len(motion.frames) / (0.4 * GALLOP.stride_s)
    short = analyse(with_exact_states(motion, GALLOP.states(motion.body, motion.frames / fps), fps))
    assert short.dynamics is not None
    assert not short.dynamics.stance_forces
    assert any(note.startswith("Forces of the feet are not computed") for note in notes(short))
    assert not any("validated" in note for note in notes(short))
    assert any("validated" in note for note in notes(found))


def test_a_body_in_flight_falls_freely(motion: Motion, found: ClipAnalysis):
    d = found.dynamics
    assert d is not None
    assert found.gait is not None
    assert len(d.flights) == len(d.flight_parts) > 0
    assert (np.abs(off_gravity(d.flight_parts)) < OFF_GRAVITY).all()
    for flight in d.flights.itertuples():
        inside = motion.time_s[flight.first : flight.stop]
        assert all(((inside < s.start_s) | (inside > s.end_s)).all() for s in found.gait.stances)
    assert findings_of_dynamics(motion, d) == ()
    # A path that is thrown at twice the frame rate falls at four times the acceleration.
    fast = d.flight_parts[0]._replace(up_m_s2=-4 * G_M_S2, sigma_m_s2=5.0)
    (one,) = findings_of_dynamics(motion, replace(d, flight_parts=[*d.flight_parts, fast]))
    assert one.code == "flight_against_gravity"
    assert one.frames == (motion.frames[fast.first], motion.frames[fast.stop - 1] + 1)


def test_the_work_of_a_stride_equals_the_gain_of_energy(found: ClipAnalysis):
    d, gait = found.dynamics, found.gait
    assert d is not None
    assert gait is not None
    summary = summarise(found, "clip")["dynamics"]
    for name, mean in summary["energy_mean_j_kg"].items():
        low, high = summary["energy_mean_interval_j_kg"][name]
        assert low < mean < high
    head, rows = strides(found)
    tabled = pd.DataFrame(rows, columns=head).set_index(["foot", "start_s"])
    for stride, row in zip(gait.strides, summary["strides"], strict=True):
        time_s = d.centre.series.time_s
        total = d.energy_j_kg["total"] - d.internal_j_kg
        ends = np.interp([stride.start_s, stride.end_s], time_s, total)
        assert row["net_work_j_kg"] == pytest.approx(ends[1] - ends[0], abs=0.5)
        table = tabled.loc[[(stride.foot, stride.start_s)]].iloc[0]
        for name, unit in OVER_STRIDE.items():
            said = [row[f"{name}{unit}"], *row[f"{name}_interval{unit}"]]
            assert said == table[[f"{name}{end}{unit}" for end in ("", "_low", "_high")]].tolist()
        low, high = row["net_work_interval_j_kg"]
        assert low < row["net_work_j_kg"] < high
        speed = np.interp([stride.start_s, stride.end_s], time_s, d.centre.speed_m_s)
        faster = np.diff(speed)[0] / stride.duration_s
        assert row["net_acceleration_m_s2"] == pytest.approx(faster, abs=0.3)
        assert row["net_acceleration_interval_m_s2"][0] < faster < row["net_acceleration_interval_m_s2"][1]
    # Over the clip, the reference joint on the trunk accelerates about as much as the centre of mass.
    net, of_joint = d.net_acceleration_m_s2, found.net_acceleration_m_s2
    assert net == pytest.approx(of_joint, rel=0.15)


@pytest.mark.parametrize(("sign", "share"), [(-1, 1.0), (1, 0.0)])
def test_a_pendulum_exchanges_its_energies_and_a_spring_does_not(found: ClipAnalysis, sign: int, share: float):
    d = found.dynamics
    assert d is not None
    series, turning = d.centre.series, 2 * np.pi * d.centre.series.time_s / 0.3
    up_m, up_m_s = 0.02 * np.cos(turning), -0.02 * 2 * np.pi / 0.3 * np.sin(turning)
    level_j_kg = 12.0 + sign * (G_M_S2 * up_m + up_m_s**2 / 2)
    value = np.stack([3.0 * series.time_s, 0 * up_m, up_m], axis=1)
    rate = np.stack([np.sqrt(2 * level_j_kg), 0 * up_m, up_m_s], axis=1)
    known = replace(series, value=value, rate=rate, value_sigma=1e-5 + 0 * rate, rate_sigma=1e-5 + 0 * rate)
    centre = replace(d.centre, series=known)
    exchanged, low, high = over_stride(replace(d, centre=centre, ground_m=0 * up_m), 0.1, 0.7)["exchange"]
    assert exchanged == pytest.approx(share, abs=1e-6)
    assert 0 < high - low < 0.02


@pytest.mark.parametrize("name", ["horse-22", "dog-27", "quadruped"])
def test_masses_of_other_animals_cover_all_segments(name: str):
    body = load_skeleton(SKELETON.with_name(f"{name}.toml"))
    assert body.mass_source
    assert {*body.mass} == {segment.name for segment in body.tree.segments}
    assert sum(share for share, _ in body.mass.values()) == pytest.approx(1, abs=0.05)
    legs = sum(share for segment, (share, _) in body.mass.items() if segment.startswith(("l_", "r_")))
    assert 0.2 < legs < 0.35


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_the_page_shows_the_forces(motion: Motion):
    page = clip_page(motion, [], None, [])
    assert "Vertical forces" in page
    plain = replace(motion, solution=replace(motion.solution, body=replace(motion.body, mass={}, mass_source=None)))
    assert "Vertical forces" not in clip_page(plain, [], None, [])


def test_the_panels_of_feet_share_a_scale_also_without_a_force(found: ClipAnalysis):
    d, gait = found.dynamics, found.gait
    assert d is not None
    assert gait is not None
    force = d.force | {"LF": np.full_like(d.force["LF"], np.nan)}
    figure = plots.forces(replace(d, force=force), gait)
    panels = {axes.texts[0].get_text(): axes for axes in figure.axes if axes.texts}
    assert len({panels[foot].get_ylim() for foot in force}) == 1
    shown = [len([text for text in panels[foot].get_yticklabels() if text.get_visible()]) > 1 for foot in force]
    assert shown == [foot != "LF" for foot in force]


def test_forces_are_in_newtons_if_the_mass_is_known(found: ClipAnalysis):
    plain, rows = forces(found)
    assert not any(name.endswith("_n") for name in plain)
    weighed, in_newtons = forces(replace(found, body_mass_kg=40.0))
    assert weighed[len(plain) :] == [
        "peak_n",
        "peak_low_n",
        "peak_high_n",
        *(f"impulse{x}_n_s" for x in ("", "_low", "_high")),
    ]
    for row, more in zip(rows, in_newtons, strict=True):
        assert more[: len(row)] == row
        np.testing.assert_allclose(more[len(row) :], np.multiply(row[3:], 40.0 * G_M_S2))
