"""Whether cameras that were refined with a fit are taken: only where no camera's pictures fit worse for it."""

from __future__ import annotations

import numpy as np

from recon.check.codes import finding
from recon.fit import TrajectorySolution
from recon.fit.result import Finding

WORSE = 1.1
"""Times a camera's median reprojection that is no change: what one camera gains, another may lose a little."""


def cameras_made_worse(refined: TrajectorySolution, held: TrajectorySolution) -> tuple[Finding, ...]:
    """Of the camera whose median reprojection got worst by refining all; none where that is no worse than `WORSE`.

    A camera that leaves its place becomes an outlier as a whole, which a robust cost rewards."""
    before, after = _medians_px(held), _medians_px(refined)
    worst = int(np.argmax(after / before))
    if not after[worst] > WORSE * before[worst]:
        return ()
    name = held.views[worst].camera.name
    return (finding("cameras_not_refined", camera=name, before_px=before[worst], after_px=after[worst]),)


def _medians_px(solution: TrajectorySolution) -> np.ndarray:
    """(V,): median distance between detections and reprojected markers; infinite where none has a pose."""
    medians = []
    for view in solution.views:
        pixels, _ = view.project(view.at_its_time(solution.markers_m))
        off = np.linalg.norm(pixels - view.xy_px, axis=-1)[view.present]
        off = np.where(np.isfinite(off), off, np.inf)
        medians.append(float(np.median(off)) if off.size else 1.0)
    return np.maximum(medians, 1e-9)
