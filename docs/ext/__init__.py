"""Tables of the reference pages, generated from the code: `python -m docs.ext` writes them."""
