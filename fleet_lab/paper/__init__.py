"""``fleet paper``: the tables and figures of the paper, recomputed on simulated drives and over a recording."""
