"""Find from the background how a camera that turns about a fixed point was turned in each frame of its video."""
