"""Writing files: the tables of a fit and of its analysis, and the formats of keypoints, 3D positions and bones."""
