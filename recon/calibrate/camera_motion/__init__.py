"""Find the orientation of a camera that turns about a fixed point, in each frame of its video, from the background."""
