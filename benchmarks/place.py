"""How well one camera can know the place at all, and whose doing what is missing is: real runs with the truth's help.

    python benchmarks/place.py [FOLDER]

Every view of `cameras.py` by itself, where the detector's keypoints lie measured in the other runs, and something of
the truth given: its poses and headings, where this view's own keypoints lie beside its markers, or detections that are
its projections: exact, with white noise of the size of the detector's, or as far off as those of other runs. Then what
other cameras say of the reference itself: all cameras of a run, and all but the one along whose line of sight the
distance is compared; and how large all of them together see the animal. One thread.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from cameras import Run, as_seen, body_of, runs_given, show, solved, states_of, with_poses

from recon import Body
from recon.animal.prior import prior_from_body
from recon.fit import constants, solve_trajectory
from recon.fit.least_squares import Estimate, LeastSquares
from recon.fit.terms import Reprojection
from recon.fit.trajectory import SegmentFit, refined, solve_segments

ROUNDS = 3
COMMON_M, OWN_M = np.arange(0.0, 0.031, 0.001), np.arange(0.01, 0.041, 0.001)
"""Standard deviations that are tried of displacements that all cameras share, and of each camera's own."""
DRAWS, SEEN = 3, 6
"""Of noise for each view; frames that a marker is seen in at least where its errors are taken from."""
OFFSET_SIGMA_M = 0.1
"""Of a view's own offsets: hardly any bound."""


def placed(run: Run, camera: int, body: Body) -> np.ndarray:
    """Joints (T, J, 3) of the truth's poses and headings, where one camera's detections have them."""
    setting = with_poses(run, [camera], body)
    states, one, T = states_of(run, setting.origin_m), np.ones((1, len(body.markers))), len(setting)
    nothing = LeastSquares(body.detected, [], [])
    found = SegmentFit(slice(0, T), Estimate(states, np.inf, 0, False), nothing, one, one[None], np.zeros((T, 4)), None)
    for _ in range(ROUNDS):
        found = refined(setting, found)
    return setting.in_world(body.tree.pose(found.estimate.states).points_m)


def orientations(run: Run, body: Body) -> np.ndarray:
    """(T, J, 3, 3): of the segments that the markers lie on, by the reference."""
    at = [[segment.name for segment in body.tree.segments].index(m.segment) for m in body.tree.markers]
    return body.tree.orientations(states_of(run, np.zeros(3)))[:, at]


def own_offsets(run: Run, camera: int, body: Body) -> Body:
    """With keypoints where this view has them beside the truth's markers, all the time."""
    view, turned, off_m = run.views[camera], orientations(run, body), np.zeros((len(body.markers), 3))
    term = Reprojection(view, np.full(view.present.shape, 15.0), 3.0, np.zeros(3))
    for _ in range(10):
        points_m = run.truth_m + (turned @ off_m[..., None])[..., 0]
        pixels, by_point, valid = view.project_with_jacobian(points_m)
        root = np.sqrt(np.nan_to_num(term.weights(points_m)))[..., None] * valid[..., None] / 15.0
        A = root[..., None] * (by_point @ turned)
        e = np.where(view.present[..., None], view.xy_px - pixels, 0.0) * root
        H = np.einsum("tjai,tjak->jik", A, A) + np.eye(3) / OFFSET_SIGMA_M**2
        pull = np.einsum("tjai,tja->ji", A, e) - off_m / OFFSET_SIGMA_M**2
        off_m = off_m + np.linalg.solve(H, pull[..., None])[..., 0]
    return replace(body, keypoint_offset_m={m: tuple(o) for m, o in zip(body.markers, off_m, strict=True)})


def in_picture(run: Run, camera: int, body: Body) -> tuple[np.ndarray, np.ndarray]:
    """Where the truth's keypoints are in the picture (T, J, 2), and how large a metre is there (T,)."""
    setting = with_poses(run, [camera], body)
    points_m = body.detected.pose(states_of(run, setting.origin_m)).points_m
    return run.views[camera].project(setting.in_world(points_m))[0], setting.px_per_m(points_m)[0]


def beside_truth(run: Run, camera: int, body: Body) -> np.ndarray:
    """(T, J, 2): how far detections lie from the truth's, metres at its distance, forwards in the picture and down."""
    xy_px, px_per_m = in_picture(run, camera, body)
    view = run.views[camera].credible()
    off_m = np.where(view.present[..., None], view.xy_px - xy_px, np.nan) / px_per_m[:, None, None]
    return off_m * [forwards(xy_px), 1.0]


def forwards(xy_px: np.ndarray) -> float:
    """1.0 where points (T, J, 2) go to the right, else -1.0."""
    return 1.0 if np.nanmean(np.diff(np.nanmean(xy_px[..., 0], axis=1))) > 0 else -1.0


def with_noise(run: Run, camera: int, body: Body, noise_m: np.ndarray) -> Run:
    """Its keypoints where the detector of a body sees them, and metres (T, J, 2) beside there as in `beside_truth`."""
    (xy_px, px_per_m), view = in_picture(run, camera, body), run.views[camera]
    xy_px = xy_px + px_per_m[:, None, None] * noise_m * [forwards(xy_px), 1.0]
    noisy = replace(view, xy_px=np.where(view.present[..., None], xy_px, np.nan))
    return replace(run, views=run.views | {camera: noisy})


def another(beside: Sequence[np.ndarray], T: int, rng: np.random.Generator) -> np.ndarray:
    """(T, J, 2): of each marker what one view of some has, from its beginning, and again and again."""
    J = beside[0].shape[1]
    noise_m = np.zeros((T, J, 2))
    for j in range(J):
        known = [of[:, j][np.isfinite(of[:, j, 0])] for of in beside]
        known = [of for of in known if len(of) >= SEEN]
        chosen = known[rng.integers(len(known))]
        noise_m[:, j] = chosen[np.arange(T) % len(chosen)]
    return noise_m


def told(run: Run, camera: int, body: Body, segments: Sequence[str]) -> np.ndarray:
    """Joints (T, J, 3) with the truth's angles of some segments."""
    setting, points_m = with_poses(run, [camera], body), np.full(run.truth_m.shape, np.nan)
    own = [any(part in name for part in segments) for name in body.tree.state_names]
    setting = replace(setting, known=np.where(own, states_of(run, setting.origin_m), np.nan))
    for segment in solve_segments(setting):
        points_m[segment.rows] = setting.in_world(body.tree.pose(segment.estimate.states).points_m)
    return points_m


def row(label: str, runs: Sequence[Run], found: Callable[[Run, int], np.ndarray], draws: int = 1) -> dict:
    """found: joints (T, J, 3) of a run and camera, each time others of so many draws."""
    mpe, mpjpe, far = [], [], []
    for run in [run for run in runs for _ in range(draws)]:
        for camera, view in run.views.items():
            points_m = found(run, camera)
            off = points_m - run.truth_m
            mpe.append(1000 * np.nanmean(np.linalg.norm(off, axis=-1)))
            mpjpe.append(1000 * np.nanmean(np.linalg.norm(off - off.mean(axis=1, keepdims=True), axis=-1)))
            here, true = (np.linalg.norm(p.mean(axis=1) - view.centre_m, axis=-1) for p in (points_m, run.truth_m))
            far.append(float(np.nanmean(np.log(here / true))))
    return {
        "known": label,
        "mpe_mm median": np.median(mpe),
        "mpe_mm mean": np.mean(mpe),
        "too far": f"{np.mean(far):+.1%}",
        "rms": f"{np.sqrt(np.mean(np.square(far))):.1%}",
        "views too far": round(np.sum(np.array(far) > 0) / draws),
        "mpjpe_mm mean": np.mean(mpjpe),
    }


def one_camera(runs: Sequence[Run]) -> list[dict]:
    seen = {run: as_seen(body_of(run.subject), run, runs, posed=True) for run in runs}

    beside = {run: [beside_truth(run, camera, seen[run]) for camera in run.views] for run in runs}
    rng = np.random.default_rng(0)

    def alone(run: Run, camera: int, body: Body) -> np.ndarray:
        return solved(run, [camera], body).joints_m

    def plain(run: Run, camera: int) -> np.ndarray:
        return solve_trajectory([run.views[camera]], seen[run], prior_from_body(seen[run]), run.fps).joints_m

    def noisy(run: Run, camera: int, white: bool) -> np.ndarray:
        body, T = seen[run], len(run.truth_m)
        if white:
            sigma_m = np.array([body.keypoint_noise_m[marker] for marker in body.markers])[:, None]
            noise_m = sigma_m * rng.normal(size=(T, len(body.markers), 2))
        else:
            noise_m = another([of for other in runs if other is not run for of in beside[other]], T, rng)
        return alone(with_noise(run, camera, body, noise_m), camera, body)

    return [
        row("nothing", runs, lambda run, camera: alone(run, camera, seen[run])),
        row("nothing, each angle on its own", runs, plain),
        row("where the view's keypoints lie", runs, lambda r, c: alone(r, c, own_offsets(r, c, seen[r]))),
        row("detections without noise", runs, lambda r, c: alone(with_noise(r, c, seen[r], np.zeros(())), c, seen[r])),
        row("detections with white noise", runs, lambda r, c: noisy(r, c, white=True), DRAWS),
        row("detections with another run's errors", runs, lambda r, c: noisy(r, c, white=False), DRAWS),
        row("headings and angles of the trunk", runs, lambda r, c: told(r, c, seen[r], ("trunk",))),
        row("angles of the legs", runs, lambda r, c: told(r, c, seen[r], ("fore", "hind"))),
        row("poses and headings", runs, lambda r, c: placed(r, c, seen[r])),
        row("poses, headings, no detector", runs, lambda r, c: placed(r, c, body_of(r.subject))),
        row("poses, headings, view's keypoints", runs, lambda r, c: placed(r, c, own_offsets(r, c, seen[r]))),
    ]


def reference(runs: Sequence[Run]) -> list[dict]:
    """What other cameras make of the reference, along each camera's line of sight."""

    def several(run: Run, cameras: Sequence[int], body: Body) -> np.ndarray:
        return solved(run, cameras, body).joints_m

    def others(run: Run, camera: int) -> list[int]:
        return [c for c in run.views if c != camera]

    seen = {run: as_seen(body_of(run.subject), run, runs, posed=True) for run in runs}
    return [
        row("all cameras", runs, lambda r, c: several(r, list(r.views), seen[r])),
        row("all cameras, no detector", runs, lambda r, c: several(r, list(r.views), body_of(r.subject))),
        row("all but that one", runs, lambda r, c: several(r, others(r, c), seen[r])),
        row("all but that one, no detector", runs, lambda r, c: several(r, others(r, c), body_of(r.subject))),
    ]


def displacements(run: Run, body: Body) -> list[tuple[np.ndarray, np.ndarray]]:
    """Of every marker: how far its keypoints lie on average beside where a body has them with the reference's poses,
    metres to the right and down in each of its n cameras, (2n,); and how a displacement in the body shows there,
    (2n, 3). What all markers of a camera have in common is taken off."""
    points_m, turned = body.detected.pose(states_of(run, np.zeros(3))).points_m, orientations(run, body)
    J = len(body.markers)
    found: list[list[tuple[np.ndarray, np.ndarray]]] = [[] for _ in range(J)]
    for view in run.views.values():
        pixels, by_point, valid = view.project_with_jacobian(points_m)
        px_per_m = view.focal_px / np.median(view.to_camera(points_m)[..., 2], axis=1)
        sigma_px = np.array([body.keypoint_noise_m[m] for m in body.markers]) * px_per_m[:, None]
        weight = np.nan_to_num(Reprojection(view, sigma_px, 3.0, np.zeros(3)).weights(points_m)) * valid
        share = weight / np.maximum(weight.sum(axis=0), 1e-9) / px_per_m[:, None]
        off_m = np.einsum("tj,tja->ja", share, np.where(weight[..., None] > 0, view.xy_px - pixels, 0.0))
        shows = np.einsum("tj,tjab->jab", share, by_point @ turned)
        seen = np.flatnonzero(view.present.sum(axis=0) >= constants.ERROR_TIME_S * run.fps)
        for j in seen:
            found[j].append((off_m[j] - np.median(off_m[seen], axis=0), shows[j]))
    return [tuple(map(np.concatenate, zip(*of, strict=True))) for of in found if of]  # type: ignore[misc]


def log_likelihoods(run: Run, body: Body) -> np.ndarray:
    """Of each of `COMMON_M` and `OWN_M`, of a run's displacements."""
    levels = np.zeros((len(COMMON_M), len(OWN_M)))
    for off_m, shows in displacements(run, body):
        C = COMMON_M[:, None, None, None] ** 2 * (shows @ shows.T) + OWN_M[:, None, None] ** 2 * np.eye(len(off_m))
        levels -= 0.5 * (np.einsum("a,...ab,b->...", off_m, np.linalg.inv(C), off_m) + np.linalg.slogdet(C)[1])
    return levels


def shares(runs: Sequence[Run]) -> list[dict]:
    """How far keypoints lie beside where the other runs have them: what all cameras share, and each one's own."""
    levels = {run: log_likelihoods(run, as_seen(body_of(run.subject), run, runs, posed=True)) for run in runs}

    def likeliest(of: Sequence[Run]) -> str:
        level = sum(levels[run] for run in of)
        common, own = np.unravel_index(np.argmax(level), np.shape(level))
        return f"{1000 * COMMON_M[common]:.0f}, {1000 * OWN_M[own]:.0f} mm: {share(COMMON_M[common], OWN_M[own]):.2f}"

    def share(common_m: float, own_m: float) -> float:
        return common_m**2 / (common_m**2 + own_m**2)

    rows = [(run.folder.name, [run], [other for other in runs if other is not run]) for run in runs]
    return [
        {"run": name, "in common, own: share": likeliest(own), "by the other runs": likeliest(others)}
        for name, own, others in [*rows, ("all", list(runs), list(runs))]
    ]


def sizes(runs: Sequence[Run]) -> list[dict]:
    """Of the subject beside its measured lengths, by all cameras."""
    rows = []
    for run in runs:
        body = as_seen(body_of(run.subject), run, runs, posed=True)
        solution = solved(run, list(run.views), body, size_sigma=0.1)
        rows.append({"run": run.folder.name, "size": solution.size, "sigma": solution.size_sigma})
    return rows


def main() -> None:
    runs = runs_given(__doc__)
    show("One camera, all views, and what it is told", one_camera(runs))
    show("The reference, along each camera's line of sight", reference(runs))
    show("Keypoints' displacements that last, by the reference's poses", shares(runs))
    show("How large all cameras see the animal, beside the lengths that the reference has", sizes(runs))


if __name__ == "__main__":
    main()
