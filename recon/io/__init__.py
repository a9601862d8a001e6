"""Read and write files: 2D keypoints, 3D positions, bones, and cameras; `FORMATS` is the table of all formats.

`recon.io.video` imports OpenCV, which takes a moment: import it inside the function that needs it.
"""
