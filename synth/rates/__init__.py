"""What a slower computer costs a controller: its norm over the sample period, and where its loop is lost."""
