"""Numbers whose sums and products round, overflow or vanish."""

from hypothesis import strategies as st

numbers = st.one_of(
    st.sampled_from([0.0, 1.0, -1.0, 0.1, 1 / 3, 5e-324, -5e-324, 1e308, -1e308, 1e-170, 1e12, -1e-12]),
    st.floats(allow_nan=False, allow_infinity=False),
)
