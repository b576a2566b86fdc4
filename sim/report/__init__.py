"""The report: one HTML page about a vehicle and its controllers.

Start with `page`, which builds the page from the sections of all studies. The modules `designs`, `agreement`, `exported` and
`summary` make the sections that no study in `sim.studies` makes. The module `one_page` makes the short report, and the module
`gallery` makes the page of the gallery.
"""
