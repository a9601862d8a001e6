"""Measure speeds and net accelerations of real runs by both methods, and test their standard deviations.

    python benchmarks/parts/speeds.py [FOLDER]

The views are all views of every run of FOLDER, by default the cheetah-runs of $RECON_SHARED_DATA. "error" and "stated"
are the error and the standard deviation of the velocity of the reference joint (root mean square over axes and frames),
relative to the spline through the reconstruction of all cameras. "error / stated" is the root mean square of the ratio
in each view. The net acceleration is measured along the path over the whole clip, in the same frames of fit and
reference.
"""

from __future__ import annotations

import numpy as np
from arguments import parser_of, runs_or_exit
from markdown_table import print_table
from recordings import fit_settings, meta_of

from recon import Motion, Pose3D, fit_clip, read_pose3d
from recon.fit.regions import radius
from recon.gait.clip import ClipAnalysis
from recon.gait.kinematics import at_frames, frame_times, net_acceleration
from recon.gait.series import series_kinematics
from recon.gait.stances import INTERVAL

METHODS = {"frame": {"method": "frame", "skeleton": "cheetah-8u"}, "trajectory": {}}


def measured(motion: Motion, truth: Pose3D) -> tuple[float, float, float, float, float, bool]:
    """Compare velocity and net acceleration of one view's fit with the reference.

    Returns
    -------
    tuple
        Error and standard deviation of the velocity, m/s; the RMS of their quotient; error and standard deviation of
        the net acceleration, m/s²; and whether the fit states the speed as known.
    """
    said = ClipAnalysis(motion)
    series = at_frames(said.reference_motion.series)
    at = truth.names.index(motion.reference)
    _, here, there = np.intersect1d(motion.frames, truth.frames, return_indices=True)
    time_s = frame_times(truth.frames, motion.fps)
    true = series_kinematics(time_s, truth.xyz_m[:, at], oversampling=1).rate[there]
    error, sigma = series.rate[here] - true, series.rate_sigma[here]
    points = np.full_like(motion.upright.xyz_m[:, 0], np.nan)
    points[here] = truth.xyz_m[there, at]
    net, net_sigma = said.net_acceleration_m_s2
    off = net - net_acceleration(motion.time_s, points)[0]
    off_by, stated, fraction = (float(np.sqrt(np.nanmean(values**2))) for values in (error, sigma, error / sigma))
    return off_by, stated, fraction, off, net_sigma, said.why_no_speed is None


def main() -> None:
    parser = parser_of(__doc__, kind="cheetah-runs")
    runs = runs_or_exit(parser, parser.parse_args().folder)
    rows = []
    for method, options in METHODS.items():
        by_run = {}
        for run in runs:
            truth = read_pose3d(run / "truth.csv")
            views = [fit_settings(run, [camera], **options) for camera in meta_of(run)["cameras"]]
            by_run[run.name] = np.array([measured(fit_clip(view), truth) for view in views], dtype=float)
        every = np.concatenate([*by_run.values()])
        for name, views in (by_run | {"all": every}).items():
            error, stated, quotient, off, sigma, known = views.T
            z = np.abs(off / sigma)
            rows.append(
                [
                    *(method, name, str(len(views)), f"{np.sqrt(np.mean(error**2)):.1f}"),
                    *(f"{np.sqrt(np.mean(stated**2)):.1f}", f"{np.sqrt(np.mean(quotient**2)):.2f}"),
                    *(f"{known.sum():.0f}", f"{np.median(np.abs(off)):.1f}", f"{np.mean(z < radius(INTERVAL)):.0%}"),
                ]
            )
    columns = (
        "method, run, views, error m/s, stated m/s, error / stated, known, net acceleration error m/s², within 90 %"
    )
    print_table(columns.split(", "), rows)


if __name__ == "__main__":
    main()
