"""What slower computers cost a controller: its norm over the sample period, and where the loop is lost."""
