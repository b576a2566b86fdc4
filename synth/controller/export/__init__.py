"""Controllers as C99 for an electronic control unit: what they compute, their source, and the folder that is handed over."""
