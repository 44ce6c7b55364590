"""Measurements of simulated arms with hidden physics. Imports nothing of Kilter: Pinocchio, numpy and scipy only."""

from tests.blind.generator.campaign import Campaign, generate
from tests.blind.generator.case import Case, Hidden
from tests.blind.generator.cases import cases, twin_cases
from tests.blind.generator.options import Options
from tests.blind.generator.truth import Truth, TruthEffect

__all__ = ["Campaign", "Case", "Hidden", "Options", "Truth", "TruthEffect", "cases", "generate", "twin_cases"]
