"""Sphinx extensions of these pages: tables generated from the code."""
