"""Define the numbers of the trajectory method that no user sets, each with its reason.

The numbers are standard deviations unless stated otherwise. Code reads them by name (`constants.ROBUST_C`), so that
tests can set other values. docs/benchmarks.md shows their effect.
"""

# Detections

ROBUST_C = 3.0
"""Number of standard deviations at which the robust weight of a residual is 0.5; a round number.

`python benchmarks/accuracy.py --only ablation` also fits with 30.
"""
KEYPOINT_BIAS_SHARE = 0.6
"""Fraction of a keypoint's distance from its marker that stays constant over a clip."""
COMMON_BIAS_SHARE = 0.4
"""Fraction of the variance of the keypoint bias that several cameras share.

The value is the most likely one in the benchmark's real runs; `python benchmarks/cameras.py --only several` also fits
with 0.
"""
NOISE_ABOUT_BIAS = 1.2
"""Factor on the variance of detections about their keypoint bias, because real bias is not quite constant over a clip.

With this factor the 90 % intervals of the benchmark's real runs contain the truth as often as if the whole bias counted
as noise (`python benchmarks/cameras.py --only several`).
"""
ERROR_TIME_S = 0.16
"""Correlation time of errors of detections, in seconds; detections within it count once in the uncertainty.

The value was chosen on the benchmark's real runs, so that 90 % regions contain about 90 % of the joints (`python
benchmarks/uncertainty.py --only views`).
"""

# Cameras and their clocks

CALIBRATED_FOCAL = 0.02
"""Relative standard deviation of a single camera's focal length from a calibration file."""
STATED_FOCAL = 0.1
"""Relative standard deviation of a single camera's focal length that is computed from a field of view.

The value is the usual error of a camera's data sheet for a video, which uses only a part of the sensor.
"""

TIME_OFFSET_FRAMES = 12**-0.5
"""Standard deviation of a camera's time offset in frames, for pictures taken at any time within a frame."""
SOUGHT_OFFSET_FRAMES = 2.0
"""Standard deviation of the time offset, in frames, of a camera whose offset is estimated."""
CAMERA_ROTATION_RAD = 0.03490658503988659
"""Standard deviation of the rotation of a camera pose that is to be refined, about each axis (2 degrees)."""
CAMERA_SHIFT_M = 0.05
"""Standard deviation of the position of a camera whose pose is to be refined, along each axis, m.

`CAMERA_SHIFT_SHARE` gives the standard deviation if the animal is close.
"""
CAMERA_SHIFT_SHARE = 0.02
"""Largest standard deviation of a camera's position, as a fraction of the distance from the animal."""
CALIBRATED_RAD = 0.008726646259971648
"""Standard deviation of the rotation between two calibrated cameras, about each axis (half a degree)."""
SHARE_OF_PAIR = 2**-0.5
"""Standard deviation of the pose of each of two cameras, relative to that between them; the two variances add up."""
WELL_CALIBRATED = 0.2
"""Standard deviations of the poses of two well calibrated cameras, relative to the usual ones.

Together with the larger errors `MISPLACED_RAD` and `MOVED`, 97 % instead of 99 % of the coordinates of the benchmark's
untouched pairs are inside 90 % intervals, and pairs with a turned camera have smaller errors (`benchmarks/cameras.py
--only pairs`).
"""
MISPLACED_RAD = 0.05235987755982988
"""Standard deviation of the rotation of a camera that is roughly calibrated, or was turned after its calibration.

The value is 3 degrees about an axis of one of two cameras. With 2 degrees, errors in the benchmark's real runs are
larger if the second camera is turned by 3 or 6 degrees.
"""
TURNED_SHARE = 0.3
"""Prior probability that the rotation of one of two cameras about an axis has the standard deviation `MISPLACED_RAD`.

If the second camera is turned by 3 degrees, 96 % of the coordinates are inside 90 % intervals, and 5 of 45 pairs have
the verdict "use" (`python benchmarks/cameras.py --only pairs`). With a probability of 0.1 these figures are 89 % and 8
of 45 (`--only turned-share`).
"""
MOVED = 8.5
"""Standard deviation of the position of a camera that was moved after its calibration, relative to the usual one.

The standard deviation is then 0.3 m, as for a tripod that was pushed, or 12 % of the distance if the animal is close.
"""
MOVED_SHARE = 0.1
"""Prior probability that the first of two cameras was moved; the second has the same probability."""
MISPLACED = 12.0
"""Factor on the usual standard deviations for a camera that was moved after calibration, or whose clock is wrong.

The standard deviations are then 6 degrees, 0.6 m and 3.5 frames. The factor is a round number.
"""
SIZE_OF_TWO_CAMERAS = 0.03
"""Relative standard deviation of a size measured by two cameras."""

LEAST_NOISE = 0.02
"""Smallest variance of a joint's detections relative to the expected variance.

The limit applies if several cameras solve for the body's shape and the detector was not measured.
"""
NOISE_COUNT = 1.0
"""Weight of the expected variance in the estimate of a joint's noise, as a number of detections."""
LENGTH_SHARE = 0.3
"""Standard deviation of a single length, relative to that of the size, if several cameras solve for the shape.

The standard deviation is increased if the solution shows that the animal's lengths vary more.
"""
OFFSET_SHARE = 0.4
"""Standard deviation of a keypoint offset, relative to that of the common bias, if several cameras solve for the shape.

The standard deviation is increased if the solution shows that the animal's offsets vary more.
"""
LENGTH_SIGMA = 0.1
"""Smallest relative standard deviation of single lengths of a skeleton without a prior, for one camera."""
FIRST_SHAPE_SCALE = (3.0, 2.5)
"""Factors on the standard deviations of lengths and offsets in the first round, which shows how much they vary."""
KNOWN_SHAPE_SCALE = (1 / 3, 1 / 2)
"""Factors on the standard deviations of lengths and offsets for a detector that was measured with the skeleton.

A detector and a skeleton that were measured together fit each other; in the benchmark's real runs, each with a detector
measured in the others, poses are then within 1 % of those with exact lengths and offsets.
"""
SHAPE_COUNT = 8.0
"""Weight of the expected spread of lengths (or offsets) when the spread is estimated from a solution.

The expected spread counts as much as this number of lengths, or of coordinates of offsets.
"""

# The animal's motion

POSE_WEIGHT = 1.0
"""Weight of the prior's distribution of poses in the cost, for each 1/90 s of a clip.

Results hardly change without these poses (`benchmarks/accuracy.py --only ablation`).
"""
MOTION_WEIGHT = 1.0
"""Weight of the prior's distribution of accelerations in the cost, for each 1/90 s of a clip.

Results hardly change without this motion (`benchmarks/accuracy.py --only ablation`).
"""
ACCELERATION_M_S2 = (12.0, 12.0, 9.0)
"""Standard deviations of the root's acceleration along the axes of the level frame.

These values, the following ones and those of standing feet come from the reconstructions behind the prior
`running-cheetah`.
"""
YAW_ACCELERATION_RAD_S2 = 40.0
"""Standard deviation of the root's angular acceleration about the vertical."""
LATERAL_M_S = 0.5
"""Standard deviation of the root's velocity across the trunk, which corresponds to 0.05 rad at 10 m/s."""
SIDESLIP_RAD = 0.1
"""Standard deviation of the constant angle between the trunk and the direction of travel, for several cameras.

The value is that of the benchmark's real runs.
`python benchmarks/cameras.py --only several` lists the angles of these runs, and also fits without the angle.
"""
CLIMB_M_S = 0.5
"""Standard deviation of the root's vertical velocity."""
MISFIT_USUAL = 3.6
"""Mean squared residual of the prior at which the misfit is 1; it exceeds 1 because a prior's errors persist over many
frames.

The mean is 2.3 to 4.6 in 32 real views at 90 to 200 Hz, 2.0 to 4.4 with every second frame.
"""
MISFIT_LEVEL = 2.0
"""Smallest misfit of a motion that is unlike those of the prior."""
MISFIT_SIGMAS = 2.33
"""Number of standard deviations that the misfit of a motion that fits the prior exceeds in 1 of 100 clips."""

# Feet and ground

SLIP_M_S = 2.5
"""Standard deviation of a standing foot's velocity."""
SLIP_C = 2.0
"""Number of standard deviations at which the loss of a foot's velocity saturates."""
GROUND_HEIGHT_M = 0.12
"""Standard deviation of the ground's height about z = 0, if the ground is known to be near z = 0."""
GROUND_SLOPE = 0.02
"""Standard deviation of the ground's slopes, if the ground is known to be near z = 0."""
GROUND_FOOT_M = 0.04
"""Standard deviation of a standing foot's height above the ground."""

# The search

NOISE_ROUNDS = 3
"""Number of rounds in which noise, contacts and ground are estimated (step 4 of `recon.fit.trajectory`).

A fast fit has one round.
"""
TOLERANCE = 1e-5
"""Relative decrease of the cost that the next step must be expected to bring; otherwise the search ends.

A fast fit uses ten times this value. Joints of five real runs are then 0.01 to 0.02 standard deviations (root mean
square) from those of a search with 1e-7.
"""
ROUGH_TOLERANCE = 1e-3
"""Value of `TOLERANCE` in rounds before the last, which only serve to estimate noise, contacts and shape spread."""
MAX_ITERATIONS = 30
"""Largest number of iterations of one search."""
