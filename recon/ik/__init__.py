"""Inverse kinematics of serial chains: of an animal's limbs, of robots' legs and arms (docs/ik.md)."""

from typing import TYPE_CHECKING

from recon.base import lazily

if TYPE_CHECKING:
    from recon.ik.clip import IkSettings, limb_of, methods_of, run_ik

__getattr__ = lazily(__name__, __file__)
