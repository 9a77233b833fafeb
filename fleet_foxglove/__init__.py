"""The fleet in Foxglove: messages of the bus as scenes, transforms, numbers and logs, and a server that serves them.

``topics`` says what there is and loads nothing; the other modules need the extra ``foxglove``.
"""
