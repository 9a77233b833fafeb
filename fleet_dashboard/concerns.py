"""What an operator should look at first, in sentences."""

import numpy as np

from fleet_dashboard.gateway import Gateway
from fleet_dashboard.picture import ASTRAY, Picture


def problems(gateway: Gateway) -> list[str]:
    """What is wrong as a whole, now: with the page, its connection, and services."""
    picture = gateway.picture
    said = [] if gateway.connected() else ["not connected to a router: what is shown is not renewed"]
    if gateway.failed:
        said.append(f"the page itself failed, and stands still: {gateway.failed:.200}")
    asked = {gateway.table.servers[i] for i in np.unique(picture.server[picture.tubed > 0]).tolist()}
    return said + gateway.services.problems(picture.t, asked)


def alarms(gateway: Gateway, picture: Picture, most: int = 3) -> list[str]:
    """Of the vehicles that do what they should not in a picture, the first ``most`` with why, and how many more."""
    rows = np.flatnonzero((picture.marks & int(ASTRAY)) != 0).tolist()
    said = []
    for row in rows[:most]:
        broken = gateway.obligations.contradicted(picture.ids[row], picture.t)
        said.append(f"{picture.ids[row]} " + "; ".join(each.words for each in broken))
    return said + ([f"and {len(rows) - most} more vehicles"] if len(rows) > most else [])
