/* A whole run: CasADi's functions, whose C stands before this text, sample after sample.
   Arrays that the page reads or writes begin with `at_`. */
int run(int samples) {
  for (int k = 0; k < samples; k++) {
    sample_arg[0] = at_memory + MEMORY * k;
    sample_arg[1] = at_noise + NOISE * k;
    sample_res[0] = at_memory + MEMORY * (k + 1);
    sample_res[1] = at_row + ROW * k;
    sample_res[2] = at_covariance + COVARIANCE * k;
    if (sample(sample_arg, sample_res, iw, w, 0)) return 1;
    errors_arg[0] = at_row + ROW * k;
    errors_res[0] = at_errors + ERRORS * k;
    if (errors(errors_arg, errors_res, iw, w, 0)) return 1;
  }
  return 0;
}
