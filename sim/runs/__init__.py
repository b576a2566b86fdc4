"""One vehicle, one road, one controller: physics beside its predictions, the verdict, and its words."""
