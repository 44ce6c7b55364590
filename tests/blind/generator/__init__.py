"""Measurements of simulated arms with hidden physics. Imports nothing of Kilter: Pinocchio, numpy and scipy only."""

from tests.blind.generator.campaign import Campaign, Truth, TruthEffect, generate
from tests.blind.generator.cases import Case, Hidden, cases
from tests.blind.generator.visits import Options

__all__ = ["Campaign", "Case", "Hidden", "Options", "Truth", "TruthEffect", "cases", "generate"]
