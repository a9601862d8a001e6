"""Robots: inverse kinematics, legged machines, retargeting, climbing."""
