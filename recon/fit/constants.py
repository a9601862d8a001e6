"""Define the numbers of the trajectory method that no user sets, and defaults that depend on the settings.

A value without a stated source is an assumption. Code reads the numbers by name (`constants.ROBUST_C`), so that tests
can set other values. `python benchmarks/accuracy.py --only ablation` fits with some of them changed.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

# Detections

ROBUST_C = 3.0
"""Residual of a detection, in standard deviations, at which its robust weight is 0.5.

The value is a round number. `python benchmarks/accuracy.py --only ablation` also fits with 30.
"""
KEYPOINT_BIAS_SHARE = 0.6
"""Ratio of the standard deviation of the keypoint bias to the standard deviation of keypoints in a single frame.

The bias stays constant over a clip. The value is an assumption for detectors that were not measured. The posterior
increases it if the detections show a larger bias.
"""
COMMON_BIAS_SHARE = 0.4
"""Fraction of the variance of the keypoint bias that several cameras share.

The value is the most likely one in the benchmark's real runs. `python benchmarks/cameras.py --only several` also fits
with 0.
"""
NOISE_ABOUT_BIAS = 1.2
"""Factor on the variance of detections about their keypoint bias, because real bias is not quite constant over a clip.

With this factor the 90 % intervals of the benchmark's real runs contain the true value as often as if the whole bias
counted as noise (`python benchmarks/cameras.py --only several`).
"""
ERROR_TIME_S = 0.16
"""Correlation time of the errors of detections, s.

Detections within this time count once in the uncertainty. The value was chosen in the benchmark's real runs, so that 90
% regions contain about 90 % of the joints (`python benchmarks/uncertainty.py --only views`).
"""

# Cameras and their clocks

CALIBRATED_FOCAL = 0.02
"""Relative standard deviation of a single camera's focal length from a calibration file.

The value is an assumption. The setting `focal_sigma` replaces it.
"""
STATED_FOCAL = 0.1
"""Relative standard deviation of a single camera's focal length that is computed from a field of view.

The value is an assumption. The field of view in a data sheet belongs to the whole sensor, of which a video often uses
only a part.
"""

TIME_OFFSET_FRAMES = 12**-0.5
"""Standard deviation of a camera's time offset, in frames, if the offset is not estimated.

Pictures may be taken at any time within a frame, so the value belongs to a uniform distribution over one frame.
"""
SOUGHT_OFFSET_FRAMES = 2.0
"""Prior standard deviation of a camera's time offset, in frames, if the offset is estimated."""
CAMERA_ROTATION_RAD = 0.03490658503988659
"""Prior standard deviation of the rotation of a camera whose pose is refined, about each axis, rad (2 degrees)."""
CAMERA_SHIFT_M = 0.05
"""Prior standard deviation of the position of a camera whose pose is uncertain, along each axis, m.

If the animal is close, `CAMERA_SHIFT_SHARE` gives a smaller value.
"""
CAMERA_SHIFT_SHARE = 0.02
"""Maximum standard deviation of a camera's position, as a fraction of its distance from the animal."""
CALIBRATED_RAD = 0.008726646259971648
"""Standard deviation of the rotation between two calibrated cameras, about each axis, rad (half a degree)."""
SHARE_OF_PAIR = 2**-0.5
"""Ratio of the standard deviation of one of two cameras' poses to that of the pose of one relative to the other.

The variances of the two poses add up, so each is half.
"""
WELL_CALIBRATED = 0.2
"""Factor on the usual standard deviations of two cameras' poses if both cameras are well calibrated.

Larger errors are covered by `MISPLACED_RAD` and `MOVED_FACTOR`. `python benchmarks/cameras.py --only pairs` counts the
coordinates that are inside 90 % intervals, for untouched pairs and for pairs with a turned camera.
"""
MISPLACED_RAD = 0.05235987755982988
"""Standard deviation of the rotation of a camera that is roughly calibrated, or was turned after its calibration, rad.

The value is 3 degrees about each axis, six times the usual error of a calibration (`CALIBRATED_RAD`).
"""
TURNED_SHARE = 0.3
"""Prior probability that the rotation of one of two cameras about an axis has the standard deviation `MISPLACED_RAD`.

`python benchmarks/cameras.py --only pairs` turns the second camera by 3 degrees, and counts the coordinates inside 90 %
intervals and the pairs with the verdict "use". With a probability of 0.1 (`--only turned-share`), fewer coordinates are
inside, and more of these pairs have the verdict "use".
"""
MOVED_FACTOR = 8.5
"""Factor on the usual standard deviation of a camera's position if the camera was moved after its calibration.

The standard deviation is then 0.3 m (a tripod that was pushed), or 12 % of the distance if the animal is close.
"""
MOVED_SHARE = 0.1
"""Prior probability, for each of two cameras, that the camera was moved after its calibration; an assumption."""
MISPLACED_FACTOR = 12.0
"""Factor on the usual standard deviations for a second camera that was turned or moved, or whose clock is wrong.

The test of the second camera uses the factor. The standard deviations are then 6 degrees, 0.6 m and 3.5 frames. The
factor is a round number.
"""
SIZE_OF_TWO_CAMERAS = 0.03
"""Relative standard deviation of the animal's size as measured by two calibrated cameras."""

MIN_NOISE = 0.02
"""Minimum variance of a joint's detections, as a fraction of the expected variance.

The limit applies if several cameras estimate the body's shape and the detector was not measured. It keeps a fit from
following a joint exactly.
"""
NOISE_COUNT = 1.0
"""Weight of the expected variance in the estimate of a joint's noise, as an equivalent number of detections.

The weight applies under the conditions of `MIN_NOISE`.
"""
LENGTH_SHARE = 0.3
"""Ratio of the standard deviation of a single length to that of the animal's size, if the shape is unknown.

The value is an assumption. With a smaller value, the estimated proportions stay closer to the skeleton's. The standard
deviation is increased if the solution shows that the animal's proportions differ more.
"""
OFFSET_SHARE = 0.4
"""Ratio of the standard deviation of a keypoint offset to that of the common keypoint bias, if the shape is estimated.

The value is an assumption. With a smaller value, the estimated offsets stay closer to the measured offsets, or to 0.
The standard deviation is increased if the solution shows larger offsets.
"""
LENGTH_SIGMA = 0.1
"""Minimum relative standard deviation of a length, if a fit cannot estimate it or the lengths were not measured."""
FIRST_SHAPE_SCALE = (3.0, 2.5)
"""Factors on the standard deviations of lengths and of offsets in the first round.

The first round is less constrained, and its solution shows how much lengths and offsets vary.
"""
KNOWN_SHAPE_SCALE = (1 / 3, 1 / 2)
"""Factors on the standard deviations of lengths and of offsets for a detector that was measured with the skeleton.

A detector and a skeleton that were measured together fit each other.
"""
SHAPE_COUNT = 8.0
"""Weight of the expected spread of lengths in the estimate of this spread, as an equivalent number of lengths.

The expected spread of offsets has the weight of the same number of coordinates.
"""

# The animal's motion

POSE_WEIGHT = 1.0
"""Weight of the prior's distribution of poses in the cost, for every 1/90 s of a clip.

`python benchmarks/accuracy.py --only ablation` also fits with one Gaussian, and without the prior.
"""
MOTION_WEIGHT = 1.0
"""Weight of the prior's distribution of accelerations in the cost, for every 1/90 s of a clip.

`python benchmarks/accuracy.py --only ablation` also fits with 0.001.
"""
ACCELERATION_M_S2 = (12.0, 12.0, 9.0)
"""Standard deviations of the root's acceleration along the axes of the level frame, m/s^2.

The values come from the reconstructions behind the prior `running-cheetah`, as do `YAW_ACCELERATION_RAD_S2`,
`LATERAL_M_S`, `CLIMB_M_S` and `SLIP_M_S`.
"""
YAW_ACCELERATION_RAD_S2 = 40.0
"""Standard deviation of the root's angular acceleration about the vertical, rad/s^2."""
LATERAL_M_S = 0.5
"""Standard deviation (m/s) of the root's velocity across the trunk, an angle of 0.05 rad at 10 m/s."""
SIDESLIP_RAD = 0.1
"""Standard deviation (rad) of the constant angle between the trunk and the direction of travel for several cameras.

`python benchmarks/cameras.py --only several` lists the angles in the benchmark's real runs, and also fits without the
angle.
"""
CLIMB_M_S = 0.5
"""Standard deviation of the root's vertical velocity, m/s."""
MISFIT_USUAL = 3.6
"""Mean squared residual of the prior at which the misfit is defined as 1.

The value is a usual mean for real clips of motions like the prior's. It exceeds 1 because a prior's errors persist over
many frames. `python benchmarks/accuracy.py --only prior` measures misfits.
"""
MISFIT_LEVEL = 2.0
"""Minimum misfit at which a motion counts as unlike the prior's motions.

`python benchmarks/accuracy.py --only prior` counts the false alarms.
"""
MISFIT_SIGMAS = 2.33
"""Quantile of the normal distribution for a false alarm in 1 of 100 clips whose motion fits the prior."""

# Feet and ground

SLIP_M_S = 2.5
"""Standard deviation of a standing foot's velocity, m/s."""
SLIP_C = 2.0
"""Velocity of a foot, in units of `SLIP_M_S`, at which the robust loss saturates (a round number)."""
GROUND_HEIGHT_M = 0.12
"""Standard deviation (m) of the ground's height about z = 0 if the ground is known to be near z = 0."""
GROUND_SLOPE = 0.02
"""Standard deviation of the ground's slope along x and along y, in metres per metre."""
GROUND_FOOT_M = 0.04
"""Standard deviation of a standing foot's height above the ground, m."""

# The search

NOISE_ROUNDS = 3
"""Number of rounds in which noise, contacts and ground are estimated (step 4 of `recon.fit.trajectory`).

A fast fit has one round, or two if it estimates the body's shape.
"""
TOLERANCE = 1e-5
"""Minimum relative decrease of the cost, expected from the next step, with which the search continues.

A fast fit uses ten times this value. The error from ending the search is far below the uncertainty of the joints.
"""
ROUGH_TOLERANCE = 1e-3
"""Minimum expected relative decrease of the cost with which the search continues, in all rounds but the last.

Earlier rounds only serve to estimate noise, contacts and the spread of the shape.
"""
MAX_ITERATIONS = 30
"""Maximum number of iterations of one search."""


def focal_sigma_of(settings: Mapping[str, Any], cameras: int) -> float | None:
    """Return the relative standard deviation of focal lengths under the settings of a fit; None if they are exact.

    Only a single, fixed camera has a default. Several cameras, or a moving one, have exact focal lengths unless the
    settings give `focal_sigma`.
    """
    sigma: float | None = settings.get("focal_sigma")
    if sigma is not None or cameras > 1 or settings.get("camera_track") is not None:
        return sigma
    return CALIBRATED_FOCAL if settings.get("hfov_deg") is None else STATED_FOCAL
