"""Tables that no reader knows: how they are laid out, and what their columns mean by names, units and ranges."""
