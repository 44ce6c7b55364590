"""Robot files of other tools as robot documents."""

from kilter_files.robots.read import Described, read_robot

__all__ = ["Described", "read_robot"]
