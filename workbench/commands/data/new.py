"""x"""
def command():
    """x"""
