"""Files as symbols of an LED panel in time, and back: framing, codes, the symbol clock, reception."""
