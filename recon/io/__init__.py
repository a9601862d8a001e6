"""Read and write files of 2D keypoints, 3D positions, bones and cameras.

`recon.io.formats.FORMATS` lists all formats.

`recon.io.video` imports OpenCV, which is slow to import, so import it inside the function that needs it.
"""
