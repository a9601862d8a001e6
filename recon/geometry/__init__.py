"""Provide rotations, frames of reference, cameras with their lenses, and kinematic trees."""
