"""Colours; style.css has the rest."""

from typing import Final

#: By label: guaranteed, calibrated, uncovered, contradicted, no tube; the last one is for what is stale. From the
#: palette of Okabe and Ito, which people with any colour vision tell apart; darker where the ground is white.
_LIGHT: Final = ((0, 128, 96), (0, 104, 178), (200, 120, 0), (204, 51, 17), (110, 118, 128), (150, 155, 162))
_DARK: Final = ((38, 190, 145), (86, 180, 233), (240, 170, 40), (255, 106, 61), (140, 150, 162), (112, 120, 132))

PALETTE: Final = {
    "light": {
        "colours": [list(colour) for colour in _LIGHT], "text": "#1f2933", "faint": "#8a95a1", "grid": "#e3e8ee",
        "region": "#5f6b7a", "active": "#8e3b9e", "halo": "#ffffff", "alarm": "#c2410c",
    },
    "dark": {
        "colours": [list(colour) for colour in _DARK], "text": "#e6ebf1", "faint": "#66727f", "grid": "#222c37",
        "region": "#8b98a7", "active": "#d78bea", "halo": "#10161d", "alarm": "#ff8a4c",
    },
}  # fmt: skip

#: Of obligations and labels in lists and plots, where one colour must do on both grounds.
COLOURS: Final = {
    "guaranteed": "#1a9e7a", "calibrated": "#2f8fd0", "uncovered": "#d08a16", "contradicted": "#dd5127",
    "no tube": "#7f8994", "stale": "#8d96a0", "pending": "#2f8fd0", "witnessed": "#1a9e7a",
}  # fmt: skip
