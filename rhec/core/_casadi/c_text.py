"""The C that CasADi generates, without asking at each use whether an argument or result is there.

An entry asks once, and what it calls gets all it needs. The arithmetic is CasADi's: no bit changes.
"""

import re
from collections import defaultdict

import casadi as ca

__all__ = ["generate_c"]

_COPY = """  if (y && x) memcpy(y, x, n*sizeof(casadi_real));
  else if (y) memset(y, 0, n*sizeof(casadi_real));"""


# What results a caller takes, or has no use for, line by line, and whom it calls for them.
_CALL = re.compile(r"(?m)^((?: *res1\[.*\n)*).*\b(casadi_f\d+)\(arg1, res1,")


def generate_c(functions, file_name, **options):
    """The text of one C file with these Functions as its entries."""
    generator = ca.CodeGenerator(file_name, options)
    for function in functions:
        generator.add(function)
    text = "#include <string.h>\n" + generator.dump()
    text = re.sub(r"(void casadi_copy\(.*\{\n)(?:.*\n)*?(?=\}\n)", rf"\1{_COPY}\n", text)
    text = _without_questions(text)
    for f in functions:
        given = [f"!arg[{i}]" for i in range(f.n_in()) if f.nnz_in(i)]
        given += [f"!res[{i}]" for i in range(f.n_out()) if f.nnz_out(i)]
        head = rf"(int {f.name()}\(const casadi_real\*\* arg.*\{{\n)"
        text = re.sub(head, rf"\1  if ({' || '.join(given)}) return 1;\n", text)
    return text


def _without_questions(text):
    """The same without asking whether arguments are there, or results that all callers take."""
    functions = re.split(r"(?m)^(?=/\* \w+:\()", text)
    left_out = defaultdict(set)  # by Function: results that a caller has no use for
    for place, body in reversed(list(enumerate(functions))):  # each after those that call it
        own = left_out[re.search(r"casadi_f\d+|$", body)[0]]
        for results, name in _CALL.findall(body):
            left_out[name].update(re.findall(r"res1\[(\d+)\]=0;", results))
        for name in re.findall(r"\b(casadi_f\d+)\((?!arg1, res1,)", body):
            left_out[name].update(own)
        body = re.sub(r"(arg\[\d+\]) ?\? (\1(?:\[\d+\])?) : (?:0|casadi_zeros)\b", r"\2", body)
        asked = "|".join(own) or "none"
        functions[place] = re.sub(rf"if \(res\[(?!{asked})[^)]*\) (?=res|casadi_copy)", "", body)
    return "".join(functions)
