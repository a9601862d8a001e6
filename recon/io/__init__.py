"""Files in and out: 2D keypoints, 3D positions, bones, and cameras. `FORMATS` is the one table of formats.

Names of `recon.io.video` import OpenCV when they are first used."""
