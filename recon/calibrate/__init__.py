"""Cameras found from pictures of a board, from a video, or planned."""
