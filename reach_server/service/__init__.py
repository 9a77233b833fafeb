"""The server: Zenoh in, engine, Zenoh out. The only package that knows network and clock."""
