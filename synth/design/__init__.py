"""A gain or a law for any plant: one file or folder for each method. It knows no vehicle."""
