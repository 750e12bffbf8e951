"""ViALUX DMDs by the ALP interface, versions 4 and 5: the maker's library, loaded by alp4lib."""
