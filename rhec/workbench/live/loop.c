/* A run of the live page: CasADi's functions, which stand before this text with their arguments and
   results, sample after sample. What is shared with the page begins with `at_`. */
int run(int samples) {
  if (start(start_arg, start_res, iw, w, 0)) return 1;
  for (int k = 0; k < samples; k++) {
    sample_arg[0] = at_memory + MEMORY * k, sample_arg[1] = at_noise + NOISE * k;
    sample_res[0] = at_memory + MEMORY * (k + 1), sample_res[1] = at_row + ROW * k;
    sample_res[2] = at_covariance + COVARIANCE * k;
    judge_arg[0] = at_tally + TALLY * (k & 1), judge_arg[1] = at_row + ROW * k;
    judge_res[0] = at_tally + TALLY * !(k & 1), judge_res[1] = at_errors + 2 * k;
    if (sample(sample_arg, sample_res, iw, w, 0) || judge(judge_arg, judge_res, iw, w, 0)) return 1;
  }
  return 0;
}

/* The desired points over the horizon at sample k, into at_xi_ref. */
int ask(int k) {
  desired_arg[0] = at_row + ROW * k, desired_arg[1] = at_memory + MEMORY * k + S;
  return desired(desired_arg, desired_res, iw, w, 0);
}
