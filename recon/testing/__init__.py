"""Simulate animals, cameras, rigs, boards and videos with known ground truth, for tests.

Fits do not use these modules:

- `recon.testing.gallop`: a galloping cheetah in front of one camera, and detections with noise, gaps and outliers;
- `recon.testing.steady_gait`: a gallop and a trot with exact forces;
- `recon.testing.walkers`: a walking person and a running mouse;
- `recon.testing.cameras`: cameras that look at a point, rings of cameras, cameras that pan;
- `recon.testing.rigs`: an animal of any skeleton inside a ring of cameras, and the files of such a clip;
- `recon.testing.boards`: pictures of calibration boards;
- `recon.testing.film`: videos of the cheetah;
- `recon.testing.files`: keypoint, label and truth files of simulated clips;
- `recon.testing.detectors`: keypoint names and files of other programs;
- `recon.testing.bones`: readers of bone files that share no code with recon's writers;
- `recon.testing.coverage`: fractions of true values inside stated intervals.
"""
