"""Simulate animals, cameras, rigs, boards and films with a known truth, for tests.

Nothing here is used by a fit. The modules:

- `recon.testing.gallop`: a galloping cheetah before one camera, and detections with noise, gaps and outliers;
- `recon.testing.steady_gait`: a gallop and a trot with exact forces;
- `recon.testing.walkers`: a walking person and a running mouse;
- `recon.testing.cameras`: cameras that look at a point, rings of cameras, cameras that pan;
- `recon.testing.rigs`: any skeleton before a ring of cameras, and the files of such a clip;
- `recon.testing.boards`: pictures of calibration boards;
- `recon.testing.film`: films of the cheetah;
- `recon.testing.files`: keypoint, label and truth files of simulated clips;
- `recon.testing.detectors`: the keypoint names and files of other programs;
- `recon.testing.bones`: readers of bone files that share nothing with recon's writers;
- `recon.testing.coverage`: how much of a truth lies within stated uncertainties.
"""
