"""Small numbers as the paper writes them."""


def scientific(value: float, digits: int) -> str:
    """Such as 9.4249e-9: no zero before the exponent."""
    mantissa, exponent = f"{value:.{digits}e}".split("e")
    return f"{mantissa}e{int(exponent)}"
