"""Roads and loads that excite a vehicle; the time derivatives of roads are exact."""
