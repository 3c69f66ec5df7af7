"""TMCL stepper modules."""
