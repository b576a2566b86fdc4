"""The report: one HTML page about a vehicle and its controllers.

Start with `page`, which builds the page from the sections of all studies. `designs`, `agreement`, `exported` and `summary` make
the sections that no study of `sim.studies` makes. `one_page` makes the short report, and `gallery` the page of the gallery.
"""
