"""Inverse kinematics of serial chains at the rate level: chains, methods, driving and following, fits (docs/ik.md)."""
