"""Opening and saving in the background."""
