"""Words and symbols of axes, titles and legends."""

SYMBOLS = {
    "phi": r"$\varphi$",
    "w3": r"$\omega_3$",
    "w_perp": r"$\omega_\perp$",
    "w1": r"$\omega_1$",
    "w2": r"$\omega_2$",
    "delta": r"$\delta$",
    "amplitude": r"$|\omega_0|$",
    "theta": r"$\vartheta$",
}
"""Symbols of the usual axes of a grid; an axis of another name is labelled by that name."""


def symbol(axis: str) -> str:
    """The label of an axis."""
    return SYMBOLS.get(axis, axis)


def capitalised(text: str) -> str:
    """The text with a capital first letter; the rest stays as it is."""
    return text[:1].upper() + text[1:]


def number(value: float) -> str:
    """Six digits at most, with a typographic minus sign."""
    return f"{value:g}".replace("-", "−")


def percent(share: float) -> str:
    """A share to 0.1 %; it reads "0 %" only if it is 0, and "100 %" only if it is 1."""
    rounded = round(share * 1000) / 10
    if 0 < share < 1 and rounded in (0, 100):
        return "> 99.9 %" if rounded else "< 0.1 %"
    return f"{rounded:g} %"
