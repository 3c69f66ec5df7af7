"""What these pages have beyond Sphinx: tables that are written from the code."""
