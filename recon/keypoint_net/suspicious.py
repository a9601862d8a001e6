"""Labels that are probably wrong, found in three ways.

- The network, once trained, puts the keypoint somewhere else and is not tempted by the label.
- The label is farther from every other label of its picture than this keypoint is anywhere else from them.
- It leaves the line through its neighbours in time.

The distances are in body lengths; a label's rank is the sum of those in which it stands out, half of it where the label
lies on the line in time: of two labels that are too far from each other, that is the right one.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from recon.base.arrays import Array, median
from recon.keypoint_net.labels import Labels

FAR, APART, JUMP = 0.2, 0.15, 0.15
"""Body lengths from which on a label stands out: from the network's point, from the others, from the line in time."""
LEARNED = 5.0
"""Times a keypoint's median distance that the network's point must be away, too: it has to know the keypoint."""
USUAL = 0.95
"""A distance between two keypoints is usual up to this quantile of it."""
MOST = 30
NEAR_FRAMES = 3
"""Neighbours in time are at most this many frames away."""


def suspicious_labels(labels: Labels, xy_px: Array, length_px: float) -> list[dict[str, Any]]:
    """The most suspicious first: image and keypoint, x_px and y_px; what speaks against the label, by the network, the
    others and time, in body lengths (NaN where it says nothing); its rank and the reasons in words.

    xy_px (N, K, 2): what the network says, in pixels of the clip, NaN in pictures that it has not learned from."""
    network = np.linalg.norm(xy_px - labels.xy_px, axis=2) / length_px
    others, time = _excess_distance_px(labels.xy_px) / length_px, _off_line_px(labels) / length_px
    far = np.fmax(FAR, LEARNED * np.array([median(of_one) for of_one in network.T]))
    found = []
    for i, k in np.argwhere(labels.labelled):
        parts = (
            (float(network[i, k]), float(far[k]), "{:.2f} body lengths from where the network sees it"),
            (float(others[i, k]), APART, "{:.2f} body lengths farther from every other label than usual"),
            (float(time[i, k]), JUMP, "{:.2f} body lengths off the line through its neighbours in time"),
        )
        reasons = tuple(text.format(value) for value, limit, text in parts if value > limit)
        if reasons:
            rank = sum(value for value, limit, _ in parts if value > limit)
            if time[i, k] <= JUMP:
                rank *= 0.5
            (x, y), against = labels.xy_px[i, k].tolist(), [value for value, *_ in parts]
            row = {"image": labels.images[i], "keypoint": labels.names[k], "x_px": x, "y_px": y}
            row |= dict(zip(("network", "others", "time"), against, strict=True))
            found.append(row | {"rank": rank, "reasons": reasons})
    return sorted(found, key=lambda row: -row["rank"])[:MOST]


def _excess_distance_px(xy_px: Array) -> Array:
    """(N, K): by how much a label is farther than usual from that of the others to which this is least so; px."""
    n, k = xy_px.shape[:2]
    least = np.full((n, k), np.inf)
    for j in range(k):
        distance = np.linalg.norm(xy_px - xy_px[:, j : j + 1], axis=2)
        distance[:, j] = np.nan
        known = np.isfinite(distance).sum(axis=0) >= 5
        usual = np.full(k, np.nan)
        usual[known] = np.nanquantile(distance[:, known], USUAL, axis=0)
        least = np.fmin(least, distance - usual)
    return np.where(np.isfinite(least), least, np.nan)


def _off_line_px(labels: Labels) -> Array:
    """(N, K): distance from a line through two near neighbours in time, before, after or on both sides, whichever is
    least: a label beside a wrong one is not wrong itself; px."""
    off = np.full(labels.labelled.shape, np.nan)
    for c in range(len(labels.clips)):
        here = np.flatnonzero(labels.clip == c)
        here = here[np.argsort(labels.numbers[here])]
        for k in range(len(labels.names)):
            known = here[labels.labelled[here, k]]
            t, p = labels.numbers[known].astype(float), labels.xy_px[known, k]
            index = np.arange(len(known))
            for a, b in ((-1, 1), (1, 2), (-1, -2)):
                i = index[(index + min(a, b, 0) >= 0) & (index + max(a, b, 0) < len(known))]
                i = i[np.maximum(np.abs(t[i + a] - t[i]), np.abs(t[i + b] - t[i])) <= NEAR_FRAMES]
                share = ((t[i] - t[i + a]) / (t[i + b] - t[i + a]))[:, None]
                line = p[i + a] + share * (p[i + b] - p[i + a])
                off[known[i], k] = np.fmin(off[known[i], k], np.linalg.norm(p[i] - line, axis=1))
    return off
