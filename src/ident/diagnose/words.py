from ident.diagnose.diagnosis import Diagnosis


def text_of(d: Diagnosis, experiment: str) -> str:
    return ""
