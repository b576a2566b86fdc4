"""One vehicle, one road, one controller: physics beside its predictions, the verdict, what acted, and its words."""
