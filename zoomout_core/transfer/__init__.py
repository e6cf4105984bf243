"""Transfer of attributes from a source surface to a target, along a map between them."""

from zoomout_core.transfer.attribute import Attribute, Domain, Kind
from zoomout_core.transfer.rules import RULES, Rule, transfer, transfer_steps

__all__ = ["RULES", "Attribute", "Domain", "Kind", "Rule", "transfer", "transfer_steps"]
