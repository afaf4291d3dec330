"""C code of CasADi Functions without CasADi's checks for missing arguments and results.

CasADi's code asks at each use whether the caller passed an argument or wants a result. Here an
entry asks once, and its inner calls pass all that is needed. The arithmetic remains CasADi's, to
the bit.
"""

import re
from collections import Counter, defaultdict

import casadi as ca

_COPY = """  if (y && x) memcpy(y, x, n*sizeof(casadi_real));
  else if (y) memset(y, 0, n*sizeof(casadi_real));"""

# From so many states on, Functions call what they share instead of having it inline, and matrices
# are loops: as scalars they would fill the compiler's time and the processor's cache.
LARGE = 10

# The product of dense matrices, z + x y: the compiler makes a vector of four sums. Each sum has the
# order of CasADi's, which waits for one number after the other.
_PRODUCT = """    for (j=0; j<ncol_y; ++j, y+=ncol_x, z+=nrow_x) {
      for (i=0; i+4<=nrow_x; i+=4) {
        const casadi_real *c=x+i;
        casadi_real z0=z[i], z1=z[i+1], z2=z[i+2], z3=z[i+3];
        for (k=0; k<ncol_x; ++k, c+=nrow_x) {
          z0 += c[0]*y[k];
          z1 += c[1]*y[k];
          z2 += c[2]*y[k];
          z3 += c[3]*y[k];
        }
        z[i]=z0;
        z[i+1]=z1;
        z[i+2]=z2;
        z[i+3]=z3;
      }
      for (; i<nrow_x; ++i) for (k=0; k<ncol_x; ++k) z[i] += x[i+k*nrow_x]*y[k];
    }"""

# A call in the code: the lines that say which results the caller takes, and the called Function.
_CALL = re.compile(r"(?m)^((?: *res1\[.*\n)*).*\b(casadi_f\d+)\(arg1, res1,")

_CALL_OF = re.compile(r"\b(casadi_f\d+)\(arg1, res1,")
_OFTEN = 8  # calls in the text
_LONG = 200  # lines of a Function
_NOINLINE = "__attribute__((noinline))"


def generate_c(functions, file_name, **options):
    """The text of a C file with these Functions as its entries."""
    generator = ca.CodeGenerator(file_name, options)
    for function in functions:
        generator.add(function)
    text = "#include <string.h>\n" + generator.dump()
    text = re.sub(r"(void casadi_copy\(.*\{\n)(?:.*\n)*?(?=\}\n)", rf"\1{_COPY}\n", text)
    if _is_large(text):
        head = r"(void casadi_mtimes_dense\((?:.*\n)*?  \} else \{\n)"
        text = re.sub(rf"{head}(?:.*\n)*?(?=  \}}\n\}}\n)", rf"\1{_PRODUCT}\n", text)
    text = _without_checks(text)
    for f in functions:
        missing = [f"!arg[{i}]" for i in range(f.n_in()) if f.nnz_in(i)]
        missing += [f"!res[{i}]" for i in range(f.n_out()) if f.nnz_out(i)]
        head = rf"(int {f.name()}\(const casadi_real\*\* arg.*\{{\n)"
        text = re.sub(head, rf"\1  if ({' || '.join(missing)}) return 1;\n", text)
    return text


def _is_large(text):
    """Whether the text has products of LARGE matrices."""
    rows = re.findall(r"casadi_mtimes_dense\([^,]+, (\d+),", text)
    return max(map(int, rows), default=0) >= LARGE


def without_inlining(text):
    """The text in which Functions that are called often by another one are not inlined into it.

    The compiler takes a quarter less time for the RHC of a model with four states, 20 intervals and
    bounds on a state; its step takes 0.1 % more instructions. Where matrices are LARGE, no Function
    of more than _LONG lines is inlined: Clang takes an eighth less time for the RHE of 12 states.
    """
    calls = Counter(_CALL_OF.findall(text))
    names = [name for name, times in calls.items() if times >= _OFTEN]
    if _is_large(text):
        names += _long_functions(text)
    if not names:
        return text
    heads = "|".join(names)
    return re.sub(rf"(?m)^static (int (?:{heads})\()", rf"static {_NOINLINE} \1", text)


def _long_functions(text):
    """Names of the Functions of more than _LONG lines."""
    parts = re.split(r"(?m)^(?=/\* \w+:\()", text)  # a comment precedes each Function
    heads = [re.search(r"casadi_f\d+", part) for part in parts if part.count("\n") > _LONG]
    return [head[0] for head in heads if head]


def _without_checks(text):
    """The text without checks for missing arguments, or for results that all callers take."""
    functions = re.split(r"(?m)^(?=/\* \w+:\()", text)
    unused_results = defaultdict(set)  # by Function: numbers of results that some caller skips
    for place, body in reversed(list(enumerate(functions))):  # callers come before what they call
        unused = unused_results[re.search(r"casadi_f\d+|$", body)[0]]
        for results, name in _CALL.findall(body):
            unused_results[name].update(re.findall(r"res1\[(\d+)\]=0;", results))
        # Where a Function passes its own results on, the inner Function's may be missing as well.
        for name in re.findall(r"\b(casadi_f\d+)\((?!arg1, res1,)", body):
            unused_results[name].update(unused)
        body = re.sub(r"(arg\[\d+\]) ?\? (\1(?:\[\d+\])?) : (?:0|casadi_zeros)\b", r"\2", body)
        checked = "|".join(unused) or "none"
        functions[place] = re.sub(rf"if \(res\[(?!{checked})[^)]*\) (?=res|casadi_copy)", "", body)
    return "".join(functions)
