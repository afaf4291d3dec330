/* acados' real-time iterations called one after the other, problem by problem, from C. */
#include <string.h>
#include <time.h>

#include "acados/ocp_nlp/ocp_nlp_sqp_rti.h"
#include "acados_c/ocp_nlp_interface.h"

/* A generated solver; without its function `solve` it is called step by step. */
struct contestant {
    ocp_nlp_solver *solver;
    ocp_nlp_in *in;
    ocp_nlp_out *out;
    int (*solve)(void *);
    void *capsule;
};

/* What a problem gives to a stage: one row of `rows`. */
struct field {
    const char *name;
    double *rows;
    long long stage, doubles;
};

static double now_us(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return 1e6 * (double)now.tv_sec + 1e-3 * (double)now.tv_nsec;
}

static void give(const struct contestant *a, const struct field *f, long long k)
{
    void *config = a->solver->config, *dims = a->solver->dims, *row = f->rows + k * f->doubles;
    int stage = (int)f->stage;
    if (strcmp(f->name, "lbx") == 0 || strcmp(f->name, "ubx") == 0)
        ocp_nlp_constraints_model_set(config, dims, a->in, BOUNDS_TAKE_OUT stage, f->name, row);
    else
        ocp_nlp_cost_model_set(config, dims, a->in, stage, f->name, row);
}

#define PARTS \
    ocp_nlp_config *config = a->solver->config; \
    ocp_nlp_dims *dims = a->solver->dims; \
    ocp_nlp_opts *opts = ((ocp_nlp_sqp_rti_opts *)a->solver->opts)->nlp_opts; \
    ocp_nlp_memory *mem = ((ocp_nlp_sqp_rti_memory *)a->solver->mem)->nlp_mem; \
    ocp_nlp_workspace *work = ((ocp_nlp_sqp_rti_workspace *)a->solver->work)->nlp_work;

/* The acados of the wheel lays its workspace out anew in every call; later ones do so once, when a
   solver is made. So with STEP_BY_STEP its steps are called here, in the order of its SQP_RTI, on
   the workspace of the call before. */
int preparation(const struct contestant *a)
{
#ifdef STEP_BY_STEP
    if (!a->solve) {
        PARTS
        ocp_nlp_initialize_submodules(config, dims, a->in, a->out, opts, mem, work);
        ocp_nlp_approximate_qp_matrices(config, dims, a->in, a->out, opts, mem, work);
        return ACADOS_SUCCESS;
    }
#endif
    return a->solve(a->capsule);
}

int feedback(const struct contestant *a)
{
#ifdef STEP_BY_STEP
    if (!a->solve) {
        PARTS
        ocp_qp_xcond_solver_config *qp = config->qp_solver;
        ocp_nlp_embed_initial_value(config, dims, a->in, a->out, opts, mem, work);
        ocp_nlp_approximate_qp_vectors_sqp(config, dims, a->in, a->out, opts, mem, work);
        int status = qp->evaluate(qp, dims->qp_solver, mem->qp_in, mem->qp_out,
                                  opts->qp_solver_opts, mem->qp_solver_mem, work->qp_work);
        ocp_nlp_update_variables_sqp(config, dims, a->in, a->out, opts, mem, work, 1.0);
        return status;
    }
#endif
    return a->solve(a->capsule);
}

/* Adds the microseconds of preparation and feedback, so many iterations a problem. */
int drive(const struct contestant *a, const struct field *fields, long long n, long long begin,
          long long end, long long iterations, double *us)
{
    int (*const phases[])(const struct contestant *) = {preparation, feedback};
    for (long long k = begin; k < end; k++) {
        for (const struct field *f = fields; f < fields + n; f++)
            give(a, f, k);
        for (long long i = 0; i < iterations; i++)
            for (int phase = 0; phase < 2; phase++) {
                int number = phase + 1;
                ocp_nlp_solver_opts_set(a->solver->config, a->solver->opts, "rti_phase", &number);
                double started = now_us();
                int status = phases[phase](a);
                us[phase] += now_us() - started;
                if (status != ACADOS_SUCCESS && status != ACADOS_MAXITER && status != ACADOS_READY)
                    return status;
            }
    }
    return 0;
}
