"""The page: where every vehicle can be, in a browser. It reads the bus and never writes to it.

``gateway`` reads the bus once for all clients; ``table`` holds the newest of each vehicle in arrays, ``picture`` is
what is true at one instant, ``history`` the pictures of the last minutes. ``view`` and ``frames`` make of a picture
what one client sees, ``live`` sends it. The rest is the page itself, in NiceGUI, and ``fleet_map.js``, which draws.
"""
