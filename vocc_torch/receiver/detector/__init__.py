"""A small learned detector of panels: a gate, a scout, a judge and a placer."""
