"""Rotations, frames of reference, cameras with their lenses, and kinematic trees."""
