"""Roads and loads that excite a vehicle, with exact time derivatives."""
