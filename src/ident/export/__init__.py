"""What was found, back in the simulator and the controller: the verb `export`."""

from ident.export.export import Export, export
from ident.export.target import Job, Product, Target

__all__ = ["Export", "Job", "Product", "Target", "export"]
