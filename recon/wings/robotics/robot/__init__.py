"""Kinematics of legged machines: motions, chains, closed forms, and an animal's motion on a robot (docs/robot.md)."""
