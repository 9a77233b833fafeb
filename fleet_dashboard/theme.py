"""Colours, and what little style the page has beside that of its elements."""

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

CSS: Final = """
:root { --ground: #f4f6f8; --panel: #ffffff; --line: #dde3e9; --quiet: #5c6875; }
.body--dark { --ground: #0b1016; --panel: #10161d; --line: #232d38; --quiet: #93a0ae; }
body { background: var(--ground) !important; }
.nicegui-content { padding: 0; gap: 0; }
.fleet-main { display: grid; grid-template-columns: minmax(0, 3fr) minmax(380px, 2fr); width: 100%;
  height: calc(100dvh - 48px); }
.fleet-left { display: flex; flex-direction: column; min-height: 0; min-width: 0; }
.fleet-right { display: flex; flex-direction: column; min-height: 0; min-width: 0; background: var(--panel);
  border-left: 1px solid var(--line); }
.fleet-map { position: relative; flex: 1; min-height: 220px; width: 100%; overflow: hidden; background: var(--panel);
  outline: none; touch-action: none; cursor: crosshair; }
.fleet-map:focus-visible { box-shadow: inset 0 0 0 2px #2f8fd0; }
.fleet-map canvas { position: absolute; inset: 0; width: 100%; height: 100%; pointer-events: none; }
.fleet-silent canvas { filter: grayscale(1) opacity(.5); }
.fleet-notice { position: absolute; top: 12px; left: 50%; transform: translateX(-50%); padding: 6px 14px;
  background: #b3380f; color: #fff; border-radius: 4px; font-weight: 500; z-index: 2; }
.fleet-card { position: absolute; pointer-events: none; padding: 6px 10px; border-radius: 4px; font-size: 12px;
line-height: 1.5; background: var(--panel); border: 1px solid var(--line); box-shadow: 0 2px 8px #0003; z-index: 1;
white-space: nowrap; } .fleet-card div:first-child { font-weight: 600; } .fleet-card[hidden], .fleet-notice[hidden] {
display: none; } .fleet-bar { display: flex; align-items: center; gap: 6px; padding: 2px 10px; min-height: 44px;
background: var(--panel); border-top: 1px solid var(--line); } .fleet-tools { position: absolute; top: 10px; right:
10px; display: flex; flex-direction: column; gap: 4px; z-index: 1; } .fleet-wrap { position: relative; display: flex;
flex: 1; min-height: 0; } .fleet-legend { position: absolute; top: 10px; left: 10px; z-index: 1; display: flex;
flex-direction: column; gap: 2px; padding: 6px 10px; border-radius: 4px; font-size: 12px; background: var(--panel);
border: 1px solid var(--line); opacity: .93; } .fleet-banner { background: #b3380f; color: #fff; padding: 6px 14px;
font-weight: 500; width: 100%; } .fleet-alarm { background: #7a4a00; }
.fleet-past { background: #6b4ba1; } .fleet-quiet { color: var(--quiet); }
.fleet-figure { font-variant-numeric: tabular-nums; } .fleet-dot { display: inline-block; width: 10px; height: 10px;
border-radius: 50%; margin-right: 6px; } .q-tab-panel { padding: 8px; } @media (max-width: 800px) { .fleet-main {
grid-template-columns: 1fr; height: auto; } .fleet-left { height: 62dvh; } .fleet-right { border-left: 0; border-top:
1px solid var(--line); height: 80dvh; } .fleet-wide { display: none !important; } }
"""
