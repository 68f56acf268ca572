"""The C that robodyn writes as LLVM IR, so that objects for other processors need no compiler of C."""
