"""`python -m ident`."""

from ident.cli.app import main

main()
