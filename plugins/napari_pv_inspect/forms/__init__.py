"""Forms for the settings, built from their declaration with magicgui."""
