"""Builds the site: python docs/build.py [FOLDER]. Warnings are errors; no network is needed."""

import sys
from pathlib import Path

from sphinx.cmd.build import main

HERE = Path(__file__).resolve().parent

if __name__ == "__main__":
    site = sys.argv[1] if len(sys.argv) > 1 else str(HERE.parent / "site")
    sys.exit(main(["-W", "--keep-going", "-q", str(HERE), site]))
