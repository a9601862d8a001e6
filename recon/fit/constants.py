"""Numbers of the trajectory method that no user sets, each with its reason. Standard deviations unless said otherwise.
Read by name (`constants.ROBUST_C`), so that tests can hold another value. docs/benchmarks.md shows what they matter."""

# -- what pictures show -------------------------------------------------------------------------------------------

ROBUST_C = 3.0
"""Residuals of so many standard deviations count half. A round number."""
KEYPOINT_BIAS_SHARE = 0.6
"""The part of a keypoint's distance from its marker that stays the same over a clip."""
COMMON_BIAS_SHARE = 0.4
"""The part of that variance which several cameras see alike: the likeliest in the benchmark's real runs."""
NOISE_ABOUT_BIAS = 1.2
"""By what the variance of detections about their keypoints' bias is multiplied, as real bias is not quite the same over
a clip: the 90 % intervals of the benchmark's real runs hold as much as if all of it counted as noise."""
ERROR_TIME_S = 0.16
"""How long errors of detections last: what is seen in that time counts once in the uncertainty. Set on the benchmark's
real runs, so that 90 % regions hold about 90 % of the joints."""

# -- what is not quite as said ------------------------------------------------------------------------------------

TIME_OFFSET_FRAMES = 12**-0.5
"""How much later or earlier than said a camera's pictures are taken: those taken anywhere within a frame."""
SOUGHT_OFFSET_FRAMES = 2.0
"""The same where cameras' offsets are to be found: a few frames."""
CAMERA_ROTATION_RAD, CAMERA_SHIFT_M, CAMERA_SHIFT_SHARE = 0.03490658503988659, 0.05, 0.02
"""How far a camera whose pose is to be refined is turned about each of its axes (2 degrees), and moved along it, in
metres or as a share of its distance from the animal, whichever is less."""
CALIBRATED_RAD = 0.008726646259971648
"""How far a camera whose pose is not to be refined is turned about each of its axes (half a degree)."""
MISPLACED = 12.0
"""So many times as far off is a camera that was moved since it was calibrated, or whose clock is wrong: 6 degrees, 0.6
m, 3.5 frames. A round number."""
SIZE_OF_TWO_CAMERAS = 0.03
"""The relative standard deviation of a size that two cameras measure."""

# -- how an animal moves ------------------------------------------------------------------------------------------

POSE_WEIGHT, MOTION_WEIGHT = 1.0, 1.0
"""How many times the prior's poses and its motion count per 1/90 s; benchmarks take them away by next to nothing."""
ACCELERATION_M_S2 = (12.0, 12.0, 9.0)
"""The accelerations of the root in the level frame: the size of what is seen in the reconstructions that the prior
`running-cheetah` is made of, as are the next and those of feet that stand."""
YAW_ACCELERATION_RAD_S2 = 40.0
LATERAL_M_S = 0.5
"""The standard deviation of the velocity across the trunk: an angle of 0.05 rad at 10 m/s."""
SIDESLIP_RAD = 0.1
"""The standard deviation of the angle to the trunk at which an animal goes all the time, with several cameras: that of
the benchmark's real runs."""
CLIMB_M_S = 0.5
"""The standard deviation of the root's vertical velocity."""
MISFIT_USUAL = 3.6
"""The prior's mean squared residual by which motions that fit have a misfit of about 1: the errors of a prior last, by
as much at any frame rate. 2.3 to 4.6 in 32 real views at 90 to 200 Hz, 2.0 to 4.4 with every second frame."""
MISFIT_LEVEL, MISFIT_SIGMAS = 2.0, 2.33
"""A motion is unlike those that the prior knows from this level on, if one that fits would by chance be as far off in 1
of 100 clips."""

# -- feet and ground ----------------------------------------------------------------------------------------------

SLIP_M_S, SLIP_C = 2.5, 2.0
"""The standard deviation of a standing foot's velocity, and how many of them the loss saturates at."""
GROUND_HEIGHT_M, GROUND_SLOPE = 0.12, 0.02
"""Standard deviations of the ground's height, where it is known to lie near z = 0, and of its slopes."""
GROUND_FOOT_M = 0.04
"""The standard deviation of the height above the ground of a foot that stands."""

# -- the search ---------------------------------------------------------------------------------------------------

NOISE_ROUNDS = 3
"""How often noise, contacts and ground are worked out anew (step 4 of `recon.fit.trajectory`); once in a fast fit."""
TOLERANCE = 1e-4
"""The relative decrease of the cost at which the search ends; ten times that in a fast fit."""
MAX_ITERATIONS = 30
