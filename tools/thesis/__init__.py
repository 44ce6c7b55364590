"""The thesis's experiments on a simulated Katana 450 that shares no code with Kilter."""
