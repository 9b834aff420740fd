"""From frames to bits: locate the panel, rectify it, measure features, classify each LED."""
