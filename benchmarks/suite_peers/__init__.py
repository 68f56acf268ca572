"""The stability suite's cases in other engines: one file for what the engines are told, one for each engine."""
