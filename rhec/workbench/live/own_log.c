/* A recorded drive: the estimator's step, sample after sample, from the memory in at_memory on. */
int run(int samples) {
  static double next[MEMORY];
  for (int k = 0; k < samples; k++) {
    replay_arg[0] = at_memory;
    replay_arg[1] = at_stream + STREAM * k;
    replay_res[0] = next;
    replay_res[1] = at_row + ROW * k;
    if (replay(replay_arg, replay_res, iw, w, 0)) return 1;
    for (int i = 0; i < MEMORY; i++) at_memory[i] = next[i];
  }
  return 0;
}
