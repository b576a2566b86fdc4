"""LMI certificates: JSON files with claims about controllers that anyone can check in rational arithmetic."""
