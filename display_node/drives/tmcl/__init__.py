"""Stepper modules that speak TMCL."""
