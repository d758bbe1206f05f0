"""A machine that keeps something to itself, for `ident demo`."""

from ident.demo.puzzle import Puzzle, make_puzzle

__all__ = ["Puzzle", "make_puzzle"]
