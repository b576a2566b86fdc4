"""LMI certificates: claims about controllers as JSON that anybody can check in rational arithmetic."""
