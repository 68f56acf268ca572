"""The IR of compiled loops as C."""
