"""Control laws: linear, semi-active and Python laws, road preview, and the designs that a section `[controllers.NAME]`
requests.
"""
