"""Figures that rate the felt pulse and the loop: errors, roughness, heart rate, deadlines."""
