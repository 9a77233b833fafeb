"""Formulas of signal temporal logic: grammar, normal forms, predicates."""
