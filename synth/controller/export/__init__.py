"""Export of controllers as C99 for an electronic control unit: the computation, its source code, and the exported folder."""
