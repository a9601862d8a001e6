"""Rotations, frames of reference, cameras and kinematic trees."""
